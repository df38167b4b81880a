"""Time laws: how fast a joint move or a joint path may run within velocity, acceleration and jerk limits (Ruckig)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import ruckig
from scipy.interpolate import CubicSpline

from cell.frames import Array
from robots.model import RobotModel

_SPEEDS = (1.0, 0.6, 0.35, 0.2)  # top speeds of a path tried, as fractions of the fastest joint's limit
_SHARES = (1.0, 0.5)  # accelerations tried, as fractions of what the top speed leaves


@dataclass(frozen=True, eq=False)
class JointPath:
    """A smooth joint path: `spline` maps s from 0 to 1 to q (6,) in [rad]."""

    spline: CubicSpline

    @property
    def start(self) -> Array:
        return np.asarray(self.spline(0.0))

    @property
    def end(self) -> Array:
        return np.asarray(self.spline(1.0))

    @cached_property
    def peaks(self) -> tuple[Array, Array, Array]:
        """Largest |q'|, |q''|, |q'''| (6,) along the path."""
        s = np.linspace(0.0, 1.0, 129)
        d1, d2, d3 = (np.abs(self.spline(s, k)).max(axis=0) for k in (1, 2, 3))
        return np.maximum(d1, 1e-9), d2, d3

    def reversed(self) -> JointPath:
        """The same path from its end to its start."""
        return JointPath(CubicSpline(1.0 - self.spline.x[::-1], self.spline(self.spline.x)[::-1], axis=0))


@dataclass(frozen=True, eq=False)
class JointSegment:
    """A six-axis Ruckig profile."""

    profile: ruckig.Trajectory

    @property
    def duration(self) -> float:
        return float(self.profile.duration)

    def at(self, times: Array) -> tuple[Array, Array]:
        """Positions and velocities (n, 6) at times (n,) in [s]."""
        states = [self.profile.at_time(t) for t in times]
        return np.array([s[0] for s in states]).reshape(-1, 6), np.array([s[1] for s in states]).reshape(-1, 6)


@dataclass(frozen=True, eq=False)
class PathSegment:
    """A joint path and its one-dimensional Ruckig profile s(t); `start_speed` is ds/dt at time 0."""

    path: JointPath
    profile: ruckig.Trajectory
    start_speed: float

    @property
    def duration(self) -> float:
        return float(self.profile.duration)

    def at(self, times: Array) -> tuple[Array, Array]:
        """Positions and velocities (n, 6) at times (n,) in [s]."""
        states = [self.profile.at_time(t) for t in times]
        s = np.clip([x[0][0] for x in states], 0.0, 1.0)
        sd = np.array([x[1][0] for x in states])
        return self.path.spline(s), self.path.spline(s, 1) * sd[:, None]


@dataclass(frozen=True, eq=False)
class Motion:
    """Segments run one after the other at the arm's full speed, ending at rest at `end` (6,)."""

    segments: tuple[JointSegment | PathSegment, ...]
    end: Array

    @property
    def duration(self) -> float:
        """At full speed, in [s]."""
        return sum(s.duration for s in self.segments)

    def sampled(self, dt: float, scale: float = 1.0) -> tuple[Array, Array]:
        """Positions and velocities (n, 6) every `dt` [s], `scale` times as fast, the last one `end` at rest."""
        starts = np.concatenate([[0.0], np.cumsum([s.duration for s in self.segments])])
        step = dt * scale
        times = np.arange(int(np.ceil(starts[-1] / step - 1e-9))) * step
        which = np.searchsorted(starts[1:-1], times, side="right")
        parts = [s.at(times[which == k] - starts[k]) for k, s in enumerate(self.segments)]
        q = np.concatenate([*(p[0] for p in parts), self.end[None]])
        qd = np.concatenate([*(p[1] * scale for p in parts), np.zeros((1, 6))])
        return q, qd


def joint_segment(
    model: RobotModel, q0: Array, q1: Array, velocity: Array | None = None, acceleration: Array | None = None
) -> JointSegment | None:
    """From rest at q0 (6,) to q1 (6,): at rest and straight in joint space, or at a given velocity and acceleration.

    None where Ruckig finds no profile; from rest to rest there always is one.
    """
    x = ruckig.InputParameter(6)
    x.current_position, x.target_position = list(q0), list(q1)
    x.max_velocity, x.max_acceleration, x.max_jerk = list(model.velocity), list(model.acceleration), list(model.jerk)
    if velocity is None or acceleration is None:
        x.synchronization = ruckig.Synchronization.Phase
    else:
        x.target_velocity, x.target_acceleration = list(velocity), list(acceleration)
    profile = _solve(x)
    return None if profile is None else JointSegment(profile)


def path_segment(model: RobotModel, path: JointPath, start: float = 0.0) -> PathSegment | None:
    """Along a path to rest, entered at `start` times its top speed; None where it cannot stop in time.

    With |q'|, |q''|, |q'''| at their largest along the path, speed v, acceleration a and jerk j of s are bounded by
        |q'| v <= V,   |q'| a + |q''| v^2 <= A,   |q'| j + 3 |q''| v a + |q'''| v^3 <= J   for every joint.
    A lower top speed leaves more acceleration and jerk, so a few are tried and the quickest is kept; on a path that
    bends sharply somewhere the speed is halved until there is one.
    """
    d1, d2, d3 = path.peaks
    top = float((model.velocity / d1).min())
    best: PathSegment | None = None
    for v in (*(top * f for f in _SPEEDS), *(top * _SPEEDS[-1] * 0.5**k for k in range(1, 12))):
        if best is not None and v < top * _SPEEDS[-1]:
            break
        most = float(((model.acceleration - d2 * v**2) / d1).min())
        for a in (most * f for f in _SHARES):
            j = float(((model.jerk - 3 * d2 * v * a - d3 * v**3) / d1).min())
            if a <= 0 or j <= 0:
                continue
            profile = _profile_1d(v, a, j, start * v)
            if profile is not None and (best is None or profile.duration < best.duration):
                best = PathSegment(path, profile, start * v)
    return best


def _profile_1d(v: float, a: float, j: float, start: float) -> ruckig.Trajectory | None:
    x = ruckig.InputParameter(1)
    x.current_position, x.target_position, x.current_velocity = [0.0], [1.0], [start]
    x.max_velocity, x.max_acceleration, x.max_jerk = [v], [a], [j]
    profile = _solve(x)
    if profile is None or (start > 0 and not _stays_inside(profile)):
        return None
    return profile


def _stays_inside(profile: ruckig.Trajectory) -> bool:
    extrema = profile.position_extrema[0]
    return bool(extrema.min >= -1e-9 and extrema.max <= 1.0 + 1e-9)


def _solve(x: ruckig.InputParameter) -> ruckig.Trajectory | None:
    profile = ruckig.Trajectory(len(x.current_position))
    result = ruckig.Ruckig(len(x.current_position)).calculate(x, profile)
    return profile if result in (ruckig.Result.Working, ruckig.Result.Finished) else None
