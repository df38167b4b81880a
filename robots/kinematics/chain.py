"""Forward kinematics of an ortho-parallel arm in closed form, compiled by numba, and the travel of its points.

Parameters of the arm are an array (19,): a1, a2, b, c1, c2, c3, c4, then signs (6,) and offsets (6,) of the joints.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from pickproof.cell.point import moved


@numba.njit(cache=True)
def flange(arm, q, T):  # type: ignore[no-untyped-def]
    """Write T_base_flange (4, 4) at q (6,) in [rad]; the last row is not written."""
    a1, a2, b, c1, c2, c3, c4 = arm[0], arm[1], arm[2], arm[3], arm[4], arm[5], arm[6]
    t1, t2 = q[0] * arm[7] - arm[13], q[1] * arm[8] - arm[14]
    t3, t4 = q[2] * arm[9] - arm[15], q[3] * arm[10] - arm[16]
    t5, t6 = q[4] * arm[11] - arm[17], q[5] * arm[12] - arm[18]
    psi, k, slope = math.atan2(a2, c3), math.hypot(a2, c3), t2 + t3
    x = c2 * math.sin(t2) + k * math.sin(slope + psi) + a1
    z = c2 * math.cos(t2) + k * math.cos(slope + psi) + c1
    s1, s4, s5, s6, s = math.sin(t1), math.sin(t4), math.sin(t5), math.sin(t6), math.sin(slope)
    k1, k4, k5, k6, c = math.cos(t1), math.cos(t4), math.cos(t5), math.cos(t6), math.cos(slope)
    wrist = ((k4 * k5 * k6 - s4 * s6, -k4 * k5 * s6 - s4 * k6, k4 * s5),
             (s4 * k5 * k6 + k4 * s6, -s4 * k5 * s6 + k4 * k6, s4 * s5),
             (-s5 * k6, s5 * s6, k5))  # fmt: skip
    for m in range(3):
        w0, w1, w2 = wrist[0][m], wrist[1][m], wrist[2][m]
        along = c * w0 + s * w2
        T[0, m] = k1 * along - s1 * w1
        T[1, m] = s1 * along + k1 * w1
        T[2, m] = -s * w0 + c * w2
    T[0, 3] = x * k1 - b * s1 + c4 * T[0, 2]
    T[1, 3] = x * s1 + b * k1 + c4 * T[1, 2]
    T[2, 3] = z + c4 * T[2, 2]


@numba.njit(cache=True)
def flanges(arm, q):  # type: ignore[no-untyped-def]
    """T_base_flange (n, 4, 4) at q (n, 6)."""
    Ts = np.zeros((len(q), 4, 4))
    for i in range(len(q)):
        flange(arm, q[i], Ts[i])
        Ts[i, 3, 3] = 1.0
    return Ts


@numba.njit(cache=True)
def travelled(arm, knots, points, thick):  # type: ignore[no-untyped-def]
    """Largest travel (n,) of any point of the arm and of `points` (m, 3) in the flange frame, up to each knot.

    Args:
        knots: (n, 6) joint vectors. thick: radius of the links around the wrist centre; twice that around the elbow.
    """
    a1, c2, c4 = arm[0], arm[4], arm[6]
    far = np.zeros(len(knots))
    Ts = flanges(arm, knots)
    for i in range(1, len(knots)):
        A, B = Ts[i - 1], Ts[i]
        most, turned = 0.0, np.abs(knots[i] - knots[i - 1])
        for k in range(len(points)):
            x0, y0, z0 = moved(A, points[k])
            x1, y1, z1 = moved(B, points[k])
            most = max(most, (x1 - x0) ** 2 + (y1 - y0) ** 2 + (z1 - z0) ** 2)
        wrist = 0.0
        for k in range(3):
            wrist += (B[k, 3] - A[k, 3] - c4 * (B[k, 2] - A[k, 2])) ** 2
        around = math.sqrt(wrist) + thick * turned.sum()
        reach = 2 * thick
        elbow = turned[0] * (a1 + c2 + reach) + turned[1] * (c2 + reach) + turned[2] * reach
        far[i] = far[i - 1] + max(math.sqrt(most), around, elbow)
    return far


@numba.njit(cache=True)
def kept_to_line(arm, q, points, way, length, corridor):  # type: ignore[no-untyped-def]
    """Index of the last of q (n, 6) up to which all `points` (m, 3) of the flange frame stay near a straight line.

    Args:
        way: (3,) unit vector. length: of the line in [m]. corridor: largest distance from it in [m].
    """
    Ts = flanges(arm, q)
    m = len(points)
    first, off = np.zeros((m, 3)), np.zeros((m, 3))
    for k in range(m):
        first[k, 0], first[k, 1], first[k, 2] = moved(Ts[0], points[k])
    for i in range(len(q)):
        along = 0.0
        for k in range(m):
            x, y, z = moved(Ts[i], points[k])
            off[k, 0], off[k, 1], off[k, 2] = x - first[k, 0], y - first[k, 1], z - first[k, 2]
            along += (off[k, 0] * way[0] + off[k, 1] * way[1] + off[k, 2] * way[2]) / m
        if along > length:
            return i - 1
        for k in range(m):
            d = 0.0
            for c in range(3):
                d += (off[k, c] - along * way[c]) ** 2
            if d > corridor**2:
                return i - 1
    return len(q) - 1
