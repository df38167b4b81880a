"""Motions that stop only where the process must: off a straight tool line, through the air, onto the next line.

The standard program of a picking robot, lines at the part and free moves with rounded corners between them: the tool
accelerates along a line from rest, leaves it in flight, and comes to rest at the end of another line. Position,
velocity and acceleration match at both junctions, so the whole motion keeps the arm's limits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cell.frames import Array
from robots.model import RobotModel
from robots.timing import JointPath, Junction, Motion, joint_segment

RAMP_SHARES = (1.0, 0.75)  # speeds at a junction that are tried, as fractions of the highest
_GRID = np.linspace(0.0, 1.0, 9)


@dataclass(frozen=True, eq=False)
class Ramp:
    """From rest at the start of `path` into flight at its end: constant jerk, then constant acceleration along it.

    Attributes:
        jerk, acceleration: of the path's parameter s in [1/s3] and [1/s2].
        landing: run backwards in time, from flight to rest.
    """

    path: JointPath
    jerk: float
    acceleration: float
    landing: bool = False

    @cached_property
    def duration(self) -> float:
        """In [s]."""
        rise = self.acceleration / self.jerk
        reached = self.jerk * rise**3 / 6
        if reached >= 1.0:
            return float((6.0 / self.jerk) ** (1 / 3))
        speed = self.jerk * rise**2 / 2
        return float(rise + (np.sqrt(speed**2 + 2 * self.acceleration * (1.0 - reached)) - speed) / self.acceleration)

    def law(self, times: Array) -> tuple[Array, Array, Array]:
        """s, ds/dt and d2s/dt2 at times (n,) after rest."""
        rise = self.acceleration / self.jerk
        early, late = np.minimum(times, rise), np.maximum(times - rise, 0.0)
        speed = self.jerk * early**2 / 2
        s = self.jerk * early**3 / 6 + speed * late + self.acceleration * late**2 / 2
        return s, speed + self.acceleration * late, self.jerk * early

    def at(self, times: Array) -> tuple[Array, Array]:
        """Positions and velocities (n, 6) at times (n,) in [s]."""
        s, sd, _ = self.law(np.clip(self.duration - times if self.landing else times, 0.0, self.duration))
        s = np.clip(s, 0.0, 1.0)
        return self.path.spline(s), self.path.spline(s, 1) * (-sd if self.landing else sd)[:, None]

    @cached_property
    def junction(self) -> Junction:
        """Where the path is left or entered."""
        _, (sd,), (sdd,) = self.law(np.array([self.duration]))
        d1, d2 = self.path.spline(1.0, 1), self.path.spline(1.0, 2)
        return Junction(self.path.end, d1 * (-sd if self.landing else sd), d2 * sd**2 + d1 * sdd)

    def slower(self, share: float) -> Ramp:
        """The same at `share` of the speed."""
        return Ramp(self.path, self.jerk * share**3, self.acceleration * share**2, self.landing)


def quickest_ramp(model: RobotModel, path: JointPath, length: float, landing: bool, limit: float | None = None) -> Ramp:
    """The fastest ramp along a straight tool line that keeps the arm's limits.

    Args:
        length: of the line in [m]. limit: largest acceleration of the tool in [m/s2], or None.
    """
    steepest = np.maximum(np.abs(path.spline(_GRID, 1)).max(axis=0), 1e-9)
    acceleration = float((model.acceleration / steepest).min())
    if limit is not None:
        acceleration = min(acceleration, limit / length)
    ramp = Ramp(path, float((model.jerk / steepest).min()), acceleration, landing)
    s, sd, sdd = ramp.law(np.linspace(0.0, ramp.duration, 201))
    d1, d2, d3 = (path.spline(np.clip(s, 0.0, 1.0), k) for k in (1, 2, 3))
    jerk = np.where(sdd < acceleration, ramp.jerk, 0.0)[:, None]
    sd, sdd = sd[:, None], sdd[:, None]
    over = max(
        float((np.abs(d1 * sd) / model.velocity).max()),
        float((np.abs(d2 * sd**2 + d1 * sdd) / model.acceleration).max()) ** (1 / 2),
        float((np.abs(d3 * sd**3 + 3 * d2 * sd * sdd + d1 * jerk) / model.jerk).max()) ** (1 / 3),
    )
    return ramp.slower(min(1.0, 0.998 / over))


def flights(
    model: RobotModel, start: Ramp | Array, end: Ramp | Array, shares: tuple[float, ...] = (1.0,)
) -> Iterator[Motion]:
    """Motions between two ends, each a line or a joint vector (6,) at rest, at several speeds of junctions and flight.

    Args:
        shares: of the arm's speed that the flight may use.
    """
    landings = list(_ends(end))
    for take_off, before, _ in _ends(start):
        for touch_down, after, q_end in landings:
            for share in shares:
                air = joint_segment(model, take_off, touch_down, share)
                if air is not None:
                    yield Motion((*before, air, *after), q_end)


def _ends(end: Ramp | Array) -> Iterator[tuple[Junction, tuple[Ramp, ...], Array]]:
    """Junction with the flight, the segments beyond it, and where these rest."""
    if isinstance(end, Ramp):
        for ramp in (end.slower(share) for share in RAMP_SHARES):
            yield ramp.junction, (ramp,), end.path.start
    else:
        yield Junction.at_rest(end), (), end
