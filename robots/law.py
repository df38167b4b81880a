"""Time laws of one parameter that runs from 0 to 1, from rest to rest, in phases of constant jerk; many at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.frames import Array

PHASES = 8  # the last is rest


@dataclass(frozen=True, eq=False)
class Law:
    """n laws s(t).

    Attributes:
        starts: (n, 8) times in [s] at which the phases begin.
        states: (4, n, 8) s and its first three derivatives there.
    """

    starts: Array
    states: Array

    @property
    def duration(self) -> Array:
        """(n,) in [s]."""
        return self.starts[:, -1]

    def at(self, times: Array) -> Array:
        """s and its first three derivatives (4, n, m) at times (n, m) in [s]; at rest before 0 and after the end."""
        k = (times[..., None] >= self.starts[:, None, 1:]).sum(axis=-1)
        row = np.arange(len(k))[:, None]
        t, early = times - self.starts[row, k], times < 0.0
        t[early] = 0.0
        s, v, a, j = self.states[:, row, k]
        j[early] = 0.0
        return np.stack([s + t * (v + t * (a / 2 + t * j / 6)), v + t * (a + t * j / 2), a + t * j, j])

    def when(self, s: float) -> Array:
        """(n,) times in [s] at which s is reached, to a hundredth of the duration."""
        times = np.linspace(0.0, 1.0, 101) * self.duration[:, None]
        return np.array([np.interp(s, *row) for row in zip(self.at(times)[0], times, strict=True)])

    def row(self, k: int) -> Law:
        """The k-th alone, n = 1."""
        return Law(self.starts[k : k + 1], self.states[:, k : k + 1])

    def rows(self, which: np.ndarray) -> Law:
        """Those of the indices (m,)."""
        return Law(self.starts[which], self.states[:, which])


def s_curve(velocity: Array, acceleration: Array, jerk: Array) -> Law:
    """The quickest laws within limits (n,) of the derivatives of s."""
    v, a, j = np.broadcast_arrays(*np.atleast_1d(velocity, acceleration, jerk))
    ramp = np.minimum(np.minimum(np.cbrt(0.5 / j), np.sqrt(v / j)), a / j)
    top = j * ramp
    # the distance without cruise, top * (ramp + hold) * (2 ramp + hold), is 1 at most
    hold = np.minimum(v / top - ramp, (np.sqrt(ramp**2 + 4.0 / top) - 3.0 * ramp) / 2.0).clip(0.0)
    cruise = (1.0 / (top * (ramp + hold)) - 2.0 * ramp - hold).clip(0.0)
    zero = np.zeros_like(j)
    return _law([ramp, hold, ramp, cruise, ramp, hold, ramp], [j, zero, -j, zero, -j, zero, j])


def rise(acceleration: Array, jerk: Array, share: Array) -> Law:
    """Hard off from rest over the first `share` (n,) of the way, within limits (n,), and softly to rest."""
    a, j, share = np.broadcast_arrays(*np.atleast_1d(acceleration, jerk, share))
    ramp = np.minimum(np.cbrt(share / j), a / j)
    hold = ((np.sqrt(ramp**2 + 8.0 * share / (j * ramp)) - 3.0 * ramp) / 2.0).clip(0.0)
    top = j * ramp * (ramp + hold)
    half = (1.0 - share) / top
    soft, zero = top / half**2, np.zeros_like(j)
    return _law([ramp, hold, ramp, half, half, zero, zero], [j, zero, -j, -soft, soft, zero, zero])


def _law(durations: list[Array], jerks: list[Array]) -> Law:
    """Phases one after the other from rest at 0."""
    T, J = np.stack(durations, axis=1), np.stack([*jerks, np.zeros_like(jerks[0])], axis=1)
    starts = np.concatenate([np.zeros((len(T), 1)), np.cumsum(T, axis=1)], axis=1)
    states = np.zeros((4, *J.shape))
    states[3] = J
    for k in range(PHASES - 1):
        t, (s, v, a, j) = T[:, k], states[:, :, k]
        states[:3, :, k + 1] = s + t * (v + t * (a / 2 + t * j / 6)), v + t * (a + t * j / 2), a + t * j
    states[:3, :, -1] = np.array([1.0, 0.0, 0.0])[:, None]  # but for rounding it is there
    return Law(starts, states)
