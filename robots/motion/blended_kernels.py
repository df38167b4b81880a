"""Compiled inner loops of `robots.motion.blended_motion`: state of a blended motion, and its fastest profiles.

`tables` (3, 5, 8) are the profiles (`robots.motion.s_curve`) of the first line, of the turn, and of the last line,
which runs backwards. `way` is the far ends (6,) of both lines, the joint offset (6,) that raises the middle, and the
lines as splines: knots x (n + 1,) from 0 to 1 and coefficients c (4, n, 6) as SciPy has them, n = 0 for no line.
`machine` is the limits (3, 6) of the joints' velocity, acceleration and jerk, the arm of `robots.kinematics.chain`, the
TCP (3,) in the flange frame and the limit of its acceleration at full speed of the arm; inf for none.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from pickproof.cell.point import moved
from pickproof.robots.kinematics.chain import flange
from pickproof.robots.motion.s_curve import rise_table, s_curve_table, state, when

# factors: speed, acceleration, jerk of the turn; then jerk and share of the first line and of the last line
FACTORS = 7
STEPS = (0.85, 0.95)  # steps by which the factors of a blended motion are varied, one round each
SHARES = (0.1, 0.7)  # shares of a line over which the tool accelerates


@numba.njit(cache=True)
def spline_at(x, c, s, out):  # type: ignore[no-untyped-def]
    """Write position and three derivatives (4, 6) at s."""
    n = c.shape[1]
    k = min(max(np.searchsorted(x, s, side="right") - 1, 0), n - 1)
    d = s - x[k]
    for j in range(6):
        c0, c1, c2, c3 = c[0, k, j], c[1, k, j], c[2, k, j], c[3, k, j]
        out[0, j] = ((c0 * d + c1) * d + c2) * d + c3
        out[1, j] = (3.0 * c0 * d + 2.0 * c1) * d + c2
        out[2, j] = 6.0 * c0 * d + 2.0 * c1
        out[3, j] = 6.0 * c0


@numba.njit(cache=True)
def at_time(t, total, wait, tables, way, line, out):  # type: ignore[no-untyped-def]
    """Write position and three derivatives (4, 6) of a blended motion at time t; `line` (4, 6) is scratch."""
    far0, far1, raised, x0, c0, x1, c1 = way
    u, v, a, j = state(tables[1], t - wait)
    for k in range(6):
        d, b = far1[k] - far0[k], 4.0 * raised[k]
        d1, d2 = d + b * (1.0 - 2.0 * u), -2.0 * b
        out[0, k] = far0[k] + d * u + b * u * (1.0 - u)
        out[1, k] = d1 * v
        out[2, k] = d2 * v * v + d1 * a
        out[3, k] = 3.0 * d2 * v * a + d1 * j
    for end in range(2):
        x, c, profile = (x0, c0, tables[0]) if end == 0 else (x1, c1, tables[2])
        if c.shape[1] == 0:
            continue
        sign = 1.0 if end == 0 else -1.0
        s, v, a, j = state(profile, t if end == 0 else total - t)
        spline_at(x, c, s, line)
        for k in range(6):
            out[0, k] += line[0, k] - (far0[k] if end == 0 else far1[k])
            out[1, k] += sign * line[1, k] * v
            out[2, k] += line[2, k] * v * v + line[1, k] * a
            out[3, k] += sign * (line[3, k] * v**3 + 3.0 * line[2, k] * v * a + line[1, k] * j)


@numba.njit(cache=True)
def sampled(times, total, wait, tables, way):  # type: ignore[no-untyped-def]
    """Positions and velocities (n, 6) at times (n,)."""
    q, qd = np.zeros((len(times), 6)), np.zeros((len(times), 6))
    line, out = np.zeros((4, 6)), np.zeros((4, 6))
    for i in range(len(times)):
        at_time(times[i], total, wait, tables, way, line, out)
        q[i], qd[i] = out[0], out[1]
    return q, qd


@numba.njit(cache=True)
def fastest(samples, total, wait, tables, way, machine, slowest):  # type: ignore[no-untyped-def]
    """Largest time scale of a blended motion within the limits of joints and TCP; 0 where below `slowest`."""
    limits, arm, tcp, shake = machine
    line, out, T = np.zeros((4, 6)), np.zeros((4, 6)), np.zeros((4, 4))
    most, step = 0.0, total / (samples - 1)
    too_much = slowest**-6 if slowest > 0.0 else np.inf
    shaken, p0, p1 = 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for i in range(samples):
        at_time(i * step, total, wait, tables, way, line, out)
        for k in range(6):
            v, a, j = abs(out[1, k]) / limits[0, k], abs(out[2, k]) / limits[1, k], abs(out[3, k]) / limits[2, k]
            most = max(most, v * v * v * v * v * v, a * a * a, j * j)
        if most > too_much:
            return 0.0
        if shake < np.inf:
            flange(arm, out[0], T)
            p2 = moved(T, tcp)
            if i > 1:
                d = 0.0
                for k in range(3):
                    d += (p2[k] - 2.0 * p1[k] + p0[k]) ** 2
                shaken = max(shaken, d)
            p0, p1 = p1, p2
    scale = most ** (-1 / 6)
    if shake < np.inf and shaken > 0.0:
        scale = min(scale, math.sqrt(shake / math.sqrt(shaken)) * step)
    return scale


@numba.njit(cache=True)
def timing(factors, top, lines, levels, off):  # type: ignore[no-untyped-def]
    """Tables (3, 5, 8) of first line, turn and last line, the wait of the turn, and the total duration.

    Args:
        factors: (FACTORS,). top: (3,) largest velocity, acceleration and jerk of the turn. lines: (2, 4) largest
            acceleration and jerk along each line, its straight share, and how far the turn moves a corner there [m]; 0
            for no line.
        levels: (2,) of waiting. off: allowed deviation of a corner from the straight part [m].
    """
    tables, waits, kept = np.zeros((3, 5, 8)), np.zeros(2), np.zeros(2)
    tables[1] = s_curve_table(top[0] * factors[0], top[1] * factors[1], top[2] * factors[2])
    for end in range(2):
        a, j, straight, reach = lines[end]
        if a == 0.0:
            continue
        hard = factors[3 + 2 * end]
        profile = rise_table(a * hard * hard, j * hard, factors[4 + 2 * end])
        kept[end] = when(profile, straight)
        least = max(kept[end] - (6.0 * off / (top[2] * factors[2] * reach)) ** (1 / 3), 0.0)
        waits[end] = least + levels[end] * max(profile[0, -1] - least, 0.0)
        tables[2 * end] = profile
    # the lines overlap in time only where neither must be straight
    total = max(tables[0, 0, -1] + kept[1], tables[2, 0, -1] + kept[0])
    return tables, waits[0], max(total, waits[0] + tables[1, 0, -1] + waits[1])


@numba.njit(cache=True)
def quickest(starts, top, lines, levels, off, samples, way, machine):  # type: ignore[no-untyped-def]
    """Factors (FACTORS,) of the fastest blended motion found from `starts` (k, FACTORS), and its time [s] at full
    speed.
    """
    best, seconds = starts[0].copy(), np.inf
    for i in range(len(starts)):
        tables, wait, total = timing(starts[i], top, lines, levels, off)
        scale = fastest(samples, total, wait, tables, way, machine, total / seconds)
        if scale > 0.0 and total / scale < seconds:
            best, seconds = starts[i].copy(), total / scale
    for step in STEPS:
        for k in range(FACTORS):
            if k > 2 and lines[(k - 3) // 2, 0] == 0.0:
                continue
            for factor in (step, 1.0 / step):
                tried = best.copy()
                tried[k] *= factor
                if k in (4, 6):
                    tried[k] = min(max(tried[k], SHARES[0]), SHARES[1])
                tables, wait, total = timing(tried, top, lines, levels, off)
                scale = fastest(samples, total, wait, tables, way, machine, total / seconds)
                if scale > 0.0 and total / scale < seconds:
                    best, seconds = tried, total / scale
                    break
    return best, seconds
