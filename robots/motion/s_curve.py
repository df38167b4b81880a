"""Motion profiles s(t) from 0 to 1, from rest to rest, in phases of constant jerk, compiled by numba.

A profile is a table (5, 8): the times at which its phases begin in [s], and s and its first three derivatives there.
The last phase is rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from pickproof.cell.frames import Array

PHASES = 8


@dataclass(frozen=True, eq=False)
class Profile:
    """s(t), see the module for its table (5, 8)."""

    table: Array

    @property
    def duration(self) -> float:
        """In [s]."""
        return float(self.table[0, -1])

    def at(self, times: Array) -> Array:
        """s and its first three derivatives (4, m) at times (m,) in [s]; at rest before 0 and after the end."""
        return np.array([state(self.table, t) for t in times]).reshape(-1, 4).T


def s_curve(velocity: float, acceleration: float, jerk: float) -> Profile:
    """The S-curve: the fastest profile within limits of the derivatives of s."""
    return Profile(s_curve_table(velocity, acceleration, jerk))


def rise(acceleration: float, jerk: float, share: float) -> Profile:
    """Acceleration at the limits over the first `share` of the way, then a slow stop."""
    return Profile(rise_table(acceleration, jerk, share))


@numba.njit(cache=True)
def state(table, t):  # type: ignore[no-untyped-def]
    """s and its first three derivatives at time t."""
    if t < 0.0:
        return 0.0, 0.0, 0.0, 0.0
    k = 0
    while k < PHASES - 1 and t >= table[0, k + 1]:
        k += 1
    t = t - table[0, k]
    s, v, a, j = table[1, k], table[2, k], table[3, k], table[4, k]
    return s + t * (v + t * (a / 2 + t * j / 6)), v + t * (a + t * j / 2), a + t * j, j


@numba.njit(cache=True)
def when(table, s):  # type: ignore[no-untyped-def]
    """Time at which s is reached, by bisection."""
    low, high = 0.0, table[0, PHASES - 1]
    for _ in range(30):
        middle = (low + high) / 2
        if state(table, middle)[0] < s:
            low = middle
        else:
            high = middle
    return high


@numba.njit(cache=True)
def s_curve_table(v, a, j):  # type: ignore[no-untyped-def]
    """Table of `s_curve`."""
    ramp = min(min((0.5 / j) ** (1 / 3), math.sqrt(v / j)), a / j)
    top = j * ramp
    # the distance without cruise, top * (ramp + hold) * (2 ramp + hold), is 1 at most
    hold = max(min(v / top - ramp, (math.sqrt(ramp**2 + 4.0 / top) - 3.0 * ramp) / 2.0), 0.0)
    cruise = max(1.0 / (top * (ramp + hold)) - 2.0 * ramp - hold, 0.0)
    durations = (ramp, hold, ramp, cruise, ramp, hold, ramp)
    return _table(durations, (j, 0.0, -j, 0.0, -j, 0.0, j))


@numba.njit(cache=True)
def rise_table(a, j, share):  # type: ignore[no-untyped-def]
    """Table of `rise`."""
    ramp = min((share / j) ** (1 / 3), a / j)
    hold = max((math.sqrt(ramp**2 + 8.0 * share / (j * ramp)) - 3.0 * ramp) / 2.0, 0.0)
    top = j * ramp * (ramp + hold)
    half = (1.0 - share) / top
    soft = top / half**2
    return _table((ramp, hold, ramp, half, half, 0.0, 0.0), (j, 0.0, -j, -soft, soft, 0.0, 0.0))


@numba.njit(cache=True)
def _table(durations, jerks):  # type: ignore[no-untyped-def]
    """Phases one after the other from rest at 0."""
    table = np.zeros((5, PHASES))
    for k in range(PHASES - 1):
        t, (s, v, a), j = durations[k], table[1:4, k], jerks[k]
        table[4, k] = j
        table[0, k + 1] = table[0, k] + t
        table[1, k + 1] = s + t * (v + t * (a / 2 + t * j / 6))
        table[2, k + 1] = v + t * (a + t * j / 2)
        table[3, k + 1] = a + t * j
    table[1, PHASES - 1], table[2, PHASES - 1], table[3, PHASES - 1] = 1.0, 0.0, 0.0  # at the end, except for rounding
    return table
