"""One free motion between two stops, each with a straight tool line that leads to it or away from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from cell.frames import Array, apply
from robots.collision import CollisionScene, Contact, Mode
from robots.flight import Ramp, flights, quickest_ramp
from robots.inverse import flange_poses
from robots.model import RobotModel
from robots.search import Method, connect_quickly, search
from robots.timing import JointPath, Motion
from robots.trajectory import (
    LINE_SAMPLES,
    Trajectory,
    concatenate,
    gentle_scale,
    move_motion,
    path_motion,
    tool_line,
)

Joined = tuple[Trajectory, Method]

CORRIDOR = 0.002  # [m] any corner of hand or part may leave a line and still count as on it
FLIGHTS_CHECKED = 3  # the quickest that are checked for collisions, for each length of the straight lines
GENTLE_SHARES = (1.0, 0.9, 0.8)  # of the arm's speed that are tried where the tool's acceleration is limited
SAMPLE_STEP = 0.003  # [m] between the points at which a line's joint vectors are exact
CHECK_STEP = 0.008  # [s] between the joint vectors that stand for a motion in collision checks


@dataclass(frozen=True, eq=False)
class Pace:
    """How fast: `speed` in (0, 1] of the arm's, samples every `dt` [s], and a TCP acceleration [m/s2] not to exceed."""

    speed: float
    dt: float
    T_flange_tool: Array
    acceleration: float | None = None


@dataclass(frozen=True, eq=False)
class Line:
    """A straight tool line away from a stop at flange pose T (4, 4) and joint vector q (6,), by `way` (3,) [m]."""

    robot: RobotModel
    T: Array
    q: Array
    way: Array

    @property
    def length(self) -> float:
        """In [m]."""
        return float(np.linalg.norm(self.way))

    @cached_property
    def path(self) -> JointPath | str:
        """In joint space, or why there is none."""
        T1 = self.T.copy()
        T1[:3, 3] += self.way
        samples = int(np.clip(np.ceil(self.length / SAMPLE_STEP), 9, LINE_SAMPLES))
        return tool_line(self.robot, self.T, T1, self.q, samples=samples)

    def first(self, length: float) -> Line:
        """Its beginning."""
        return replace(self, way=self.way * min(1.0, length / self.length))


@dataclass(frozen=True, eq=False)
class Stop:
    """Where a motion starts or ends at rest.

    Attributes:
        q: (6,) in [rad].
        line: away from it; None where the arm may move as it likes.
        mode: of the collision checks along the line.
        straight: how much of the line is kept straight where that is enough, in [m]; None for all of it.
    """

    q: Array
    line: Line | None = None
    mode: Mode = "transit"
    straight: float | None = None

    @property
    def lines(self) -> tuple[Line, ...]:
        """What to keep straight, the least first."""
        if self.line is None:
            return ()
        short = self.straight is not None and self.straight < 0.8 * self.line.length
        return (self.line.first(self.straight or 0.0), self.line) if short else (self.line,)


def join(scene: CollisionScene, start: Stop, end: Stop, pace: Pace, seed: int | None, name: str) -> Joined | str:
    """From one stop along its line, through the air, and along the line to the other; or what is in the way.

    Only a short stretch of each line is kept straight if that stays free; else the whole of it. Where no flight is free
    the arm stops at the ends of the whole lines and goes straight, over a via point, or as a search finds.

    Args:
        seed: of the search; None for no search.
    """
    for k in range(max(len(start.lines), len(end.lines), 1)):
        flying = _fly(scene, start, end, k, pace, name)
        if flying is not None:
            return flying, "direct"
    paths = [stop.line.path if stop.line else None for stop in (start, end)]
    for stop, path in zip((start, end), paths, strict=True):
        if isinstance(path, str):
            return f"on the line, {path}"
        contact = path and scene.path_contact(path.spline(np.linspace(0.0, 1.0, 33)), stop.mode)
        if contact:
            return f"on the line, {describe(contact)}"
    first, last = paths
    assert not isinstance(first, str) and not isinstance(last, str)
    q0, q1 = first.end if first else start.q, last.end if last else end.q
    found = connect_quickly(scene, q0, q1)
    if found is None and seed is not None:
        searched = search(scene, q0, q1, seed)
        found = None if searched is None else (searched, "search")
    if found is None:
        return describe(scene.path_contact(np.stack([q0, q1])))
    waypoints, method = found
    parts = [_run(scene, first, pace, name)] if first else []
    parts.append(_along(scene, waypoints, pace, name))
    if last:
        parts.append(_run(scene, last.reversed(), pace, name))
    return concatenate(name, parts), method


def duration(robot: RobotModel, motion: Motion, pace: Pace) -> float:
    """Of a motion at a pace, in [s]."""
    return motion.duration / _scale(robot, motion, pace)


def describe(contact: Contact | None) -> str:
    """What a contact says to a reader."""
    return "nothing" if contact is None else f"{contact[0]} touches {contact[1]}"


def _fly(scene: CollisionScene, start: Stop, end: Stop, k: int, pace: Pace, name: str) -> Trajectory | None:
    """The quickest free motion without a stop in between that keeps straight for the k-th length of the lines."""
    robot, ends = scene.robot, list[Ramp | Array]()
    for stop, landing in ((start, False), (end, True)):
        if not stop.lines:
            ends.append(stop.q)
            continue
        line = stop.lines[min(k, len(stop.lines) - 1)]
        if isinstance(line.path, str):
            return None
        ends.append(quickest_ramp(robot, line.path, line.length, landing, pace.acceleration))
    shares = (1.0,) if pace.acceleration is None else GENTLE_SHARES
    options: list[tuple[float, float, Motion]] = []
    best = np.inf
    for motion in flights(robot, ends[0], ends[1], shares):
        if motion.duration / pace.speed >= best and len(options) >= FLIGHTS_CHECKED:
            continue
        scale = _scale(robot, motion, pace)
        options.append((motion.duration / scale, scale, motion))
        best = min(best, options[-1][0])
    for _, scale, motion in sorted(options, key=lambda o: o[0])[:FLIGHTS_CHECKED]:
        if _free(scene, motion, start, end, pace):
            return Trajectory(name, *motion.sampled(pace.dt, scale), pace.dt)
    return None


def _free(scene: CollisionScene, motion: Motion, start: Stop, end: Stop, pace: Pace) -> bool:
    """Whether a motion keeps the joint limits and touches nothing, each stretch checked in its mode."""
    q = motion.sampled(CHECK_STEP)[0]
    if not scene.robot.within_limits(q).all():
        return False
    first = _on_line(scene, q, start)
    last = len(q) - 1 - _on_line(scene, q[::-1], end)
    if first >= last:
        first, last = 0, len(q) - 1
    stretches: Sequence[tuple[Array, Mode]] = (
        (q[first : last + 1], "transit"),
        (q[: first + 1], start.mode),
        (q[last:], end.mode),
    )
    return all(scene.free_path(qs, mode) for qs, mode in stretches if len(qs) > 1 or mode != "transit")


def _on_line(scene: CollisionScene, q: Array, stop: Stop) -> int:
    """Index of the last of q (n, 6) up to which hand and part stay in the corridor of the stop's whole line."""
    if stop.line is None or stop.mode == "transit":
        return 0
    length = stop.line.length
    way = stop.line.way / length
    moved = apply(flange_poses(scene.robot, q), scene.corners)
    moved = moved - moved[0]
    along = (moved @ way).mean(axis=1)
    off = np.linalg.norm(moved - along[:, None, None] * way, axis=-1).max(axis=1)
    outside = (off > CORRIDOR) | (along > length)
    return int(np.argmax(outside)) - 1 if outside.any() else len(q) - 1


def _run(scene: CollisionScene, line: JointPath, pace: Pace, name: str) -> Trajectory:
    """Along a line from rest to rest."""
    return _sampled(scene.robot, path_motion(scene.robot, line), pace, name)


def _along(scene: CollisionScene, waypoints: Array, pace: Pace, name: str) -> Trajectory:
    """Through waypoints: on a smooth curve where it is free and quicker, else straight with a stop at each."""
    robot = scene.robot
    stops = [move_motion(robot, a, b) for a, b in pairwise(waypoints)]
    if len(waypoints) > 2:
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1))])
        curve = JointPath(CubicSpline(s / s[-1], waypoints, axis=0))
        smooth = path_motion(robot, curve)
        q = curve.spline(np.linspace(0.0, 1.0, 200))
        quicker = duration(robot, smooth, pace) < sum(duration(robot, m, pace) for m in stops)
        if quicker and robot.within_limits(q).all() and scene.free_path(q):
            return _sampled(robot, smooth, pace, name)
    return concatenate(name, [_sampled(robot, m, pace, name) for m in stops])


def _scale(robot: RobotModel, motion: Motion, pace: Pace) -> float:
    if pace.acceleration is None:
        return pace.speed
    return min(pace.speed, gentle_scale(robot, motion, pace.T_flange_tool, pace.acceleration))


def _sampled(robot: RobotModel, motion: Motion, pace: Pace, name: str) -> Trajectory:
    return Trajectory(name, *motion.sampled(pace.dt, _scale(robot, motion, pace)), pace.dt)
