"""Motion profiles of joint moves and paths, within limits of velocity, acceleration and jerk (Ruckig)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import ruckig
from scipy.interpolate import CubicSpline

from pickproof.cell.frames import Array
from pickproof.robots.kinematics.model import RobotModel

_SPEEDS = (1.0, 0.6, 0.35, 0.2)  # tried top speeds of a path, as shares of the limit of the fastest joint
_SHARES = (1.0, 0.5)  # tried accelerations, as shares of what remains at the top speed


@dataclass(frozen=True, eq=False)
class JointPath:
    """A smooth joint path: `spline` maps s from 0 to 1 to q (6,) in [rad]."""

    spline: CubicSpline

    @cached_property
    def start(self) -> Array:
        """q (6,) [rad] at s = 0."""
        return np.asarray(self.spline(0.0))

    @cached_property
    def end(self) -> Array:
        """q (6,) [rad] at s = 1."""
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


class Segment(Protocol):
    """A segment of a motion."""

    @property
    def duration(self) -> float:
        """In [s]."""

    def at(self, times: Array) -> tuple[Array, Array]:
        """Positions and velocities (n, 6) at times (n,) in [s]."""


@dataclass(frozen=True, eq=False)
class JointSegment:
    """A six-axis Ruckig profile."""

    profile: ruckig.Trajectory

    @property
    def duration(self) -> float:
        """[s] from start to end."""
        return float(self.profile.duration)

    @cached_property
    def _phases(self) -> tuple[Array, Array] | None:
        """Start times (6, 8) of phases of constant jerk and (4, 6, 8) position, velocity, acceleration, jerk there.

        None where Ruckig has additional phases before or after these, because a limit is violated at an end.
        """
        joints = self.profile.profiles[0]
        if any(p.brake.duration > 0.0 or p.accel.duration > 0.0 for p in joints):
            return None
        starts = np.array([np.concatenate([[0.0], np.cumsum(p.t)]) for p in joints])
        jerks = np.array([[*p.j, 0.0] for p in joints])
        return starts, np.stack([np.array([getattr(p, name) for p in joints]) for name in "pva"] + [jerks])

    def at(self, times: Array) -> tuple[Array, Array]:
        """Positions and velocities (n, 6) at times (n,) in [s], all at once; Ruckig takes 2 us for each."""
        if self._phases is None:
            states = [self.profile.at_time(t) for t in times]
            return np.array([s[0] for s in states]).reshape(-1, 6), np.array([s[1] for s in states]).reshape(-1, 6)
        starts, phases = self._phases
        k = (np.asarray(times)[:, None, None] >= starts).sum(axis=2).clip(1) - 1
        joint = np.arange(6)
        p, v, a, j = phases[:, joint, k]
        t = np.asarray(times)[:, None] - starts[joint, k]
        return p + t * (v + t * (a / 2 + t * j / 6)), v + t * (a + t * j / 2)


@dataclass(frozen=True, eq=False)
class PathSegment:
    """A joint path and its one-dimensional Ruckig profile s(t)."""

    path: JointPath
    profile: ruckig.Trajectory

    @property
    def duration(self) -> float:
        """[s] from start to end."""
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

    segments: tuple[Segment, ...]
    end: Array

    @property
    def duration(self) -> float:
        """Duration at full speed, in [s]."""
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


def rest_to_rest(model: RobotModel, turned: Array) -> Array:
    """Time (...) in [s] of the fastest motion of all joints by `turned` (..., 6) [rad] from rest to rest.

    It is the time of the slowest joint.
    """
    d, v, a, j = np.abs(turned), model.velocity, model.acceleration, model.jerk
    by_jerk = 4.0 * np.cbrt(d / (2.0 * j))
    peak = a * (np.sqrt((a / j) ** 2 + 4.0 * d / a) - a / j) / 2.0  # d = peak * (peak / a + a / j)
    by_acceleration = 2.0 * (peak / a + a / j)
    by_velocity = d / v + v / a + a / j
    short, middle = d <= 2.0 * a**3 / j**2, d <= v * (v / a + a / j)
    return np.asarray(np.where(short, by_jerk, np.where(middle, by_acceleration, by_velocity)).max(axis=-1))


def joint_segment(model: RobotModel, q0: Array, q1: Array) -> JointSegment:
    """The fastest motion from rest at q0 (6,) to rest at q1 (6,), straight in joint space.

    Raises:
        ValueError: Ruckig finds no profile; one exists between any two finite joint vectors.
    """
    x = ruckig.InputParameter(6)
    x.current_position, x.target_position = q0.tolist(), q1.tolist()
    x.max_velocity, x.max_acceleration, x.max_jerk = (
        limit.tolist() for limit in (model.velocity, model.acceleration, model.jerk)
    )
    x.synchronization = ruckig.Synchronization.Phase
    profile = _solve(x)
    if profile is None:
        raise ValueError(f"no motion profile from {q0} to {q1}")
    return JointSegment(profile)


def path_segment(model: RobotModel, path: JointPath) -> PathSegment | None:
    """Motion along a path from rest to rest.

    With |q'|, |q''|, |q'''| at their largest along the path, speed v, acceleration a and jerk j of s are bounded by
        |q'| v <= V,   |q'| a + |q''| v^2 <= A,   |q'| j + 3 |q''| v a + |q'''| v^3 <= J   for every joint.
    A lower top speed allows more acceleration and jerk, so several are tried and the fastest motion is kept. On a path
    with a sharp bend the speed is halved until a profile exists.
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
            profile = _profile_1d(v, a, j)
            if profile is not None and (best is None or profile.duration < best.duration):
                best = PathSegment(path, profile)
    return best


def _profile_1d(v: float, a: float, j: float) -> ruckig.Trajectory | None:
    x = ruckig.InputParameter(1)
    x.current_position, x.target_position = [0.0], [1.0]
    x.max_velocity, x.max_acceleration, x.max_jerk = [v], [a], [j]
    return _solve(x)


def _solve(x: ruckig.InputParameter) -> ruckig.Trajectory | None:
    profile = ruckig.Trajectory(len(x.current_position))
    try:
        result = ruckig.Ruckig(len(x.current_position)).calculate(x, profile)
    except ruckig.RuckigError:  # from this boundary state the limits cannot be kept
        return None
    return profile if result in (ruckig.Result.Working, ruckig.Result.Finished) else None
