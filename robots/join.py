"""A free move that ends on a straight tool line: the shape of every approach, carry and return."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from cell.frames import Array
from robots.collision import CollisionScene, Contact
from robots.search import Method, connect_quickly, search
from robots.timing import JointPath, Motion
from robots.trajectory import (
    Trajectory,
    concatenate,
    flying_motion,
    gentle_scale,
    move_motion,
    path_motion,
)

Joined = tuple[Trajectory, Method]

FLY_BY = (1.0, 0.6, 0.3)  # speeds tried at the junction, as fractions of the line's own top speed


@dataclass(frozen=True, eq=False)
class Pace:
    """How fast: `speed` in (0, 1] of the arm's, samples every `dt` [s], and a TCP acceleration [m/s2] not to exceed."""

    speed: float
    dt: float
    T_flange_tool: Array
    acceleration: float | None = None


def enter_line(
    scene: CollisionScene, q0: Array, line: JointPath, pace: Pace, seed: int | None, name: str
) -> Joined | str:
    """From rest at q0 (6,) to the start of `line`, along it, to rest at its end; or what is in the way.

    The line itself has been checked by the caller; the way to it is checked here, in mode `transit`. Where the straight
    move is free the junction is passed without a stop, as fast as stays free.

    Args:
        seed: of the search that runs where straight and via moves are blocked; None for no search.
    """
    flying = _fly(scene, q0, line, pace, name)
    if flying is not None:
        return flying, "direct"
    found = connect_quickly(scene, q0, line.start)
    if found is None and seed is not None:
        path = search(scene, q0, line.start, seed)
        found = None if path is None else (path, "search")
    if found is None:
        return describe(scene.path_contact(np.stack([q0, line.start])))
    waypoints, method = found
    way = _along(scene, waypoints, pace, name)
    return concatenate(name, [way, run(scene, line, pace, name)]), method


def run(scene: CollisionScene, line: JointPath, pace: Pace, name: str) -> Trajectory:
    """Along a line from rest to rest."""
    return _sampled(scene, path_motion(scene.robot, line), pace, name)


def describe(contact: Contact | None) -> str:
    """What a contact says to a reader."""
    return "nothing" if contact is None else f"{contact[0]} touches {contact[1]}"


def _fly(scene: CollisionScene, q0: Array, line: JointPath, pace: Pace, name: str) -> Trajectory | None:
    """The quickest free trajectory through the junction without a stop, if it beats stopping there."""
    robot = scene.robot
    stop = _duration(scene, move_motion(robot, q0, line.start), pace) + _duration(scene, path_motion(robot, line), pace)
    flying = [m for f in FLY_BY if (m := flying_motion(robot, q0, line, f)) is not None]
    for duration, motion in sorted(((_duration(scene, m, pace), m) for m in flying), key=lambda o: o[0]):
        if duration >= stop:
            return None
        entry = Motion(motion.segments[:1], line.start).sampled(pace.dt)[0]
        if robot.within_limits(entry).all() and scene.free_path(entry):
            return _sampled(scene, motion, pace, name)
    return None


def _along(scene: CollisionScene, waypoints: Array, pace: Pace, name: str) -> Trajectory:
    """Through waypoints: on a smooth curve where it is free and quicker, else straight with a stop at each."""
    robot = scene.robot
    stops = [move_motion(robot, a, b) for a, b in pairwise(waypoints)]
    if len(waypoints) > 2:
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1))])
        curve = JointPath(CubicSpline(s / s[-1], waypoints, axis=0))
        smooth = path_motion(robot, curve)
        q = curve.spline(np.linspace(0.0, 1.0, 200))
        quicker = _duration(scene, smooth, pace) < sum(_duration(scene, m, pace) for m in stops)
        if quicker and robot.within_limits(q).all() and scene.free_path(q):
            return _sampled(scene, smooth, pace, name)
    return concatenate(name, [_sampled(scene, m, pace, name) for m in stops])


def _scale(scene: CollisionScene, motion: Motion, pace: Pace) -> float:
    if pace.acceleration is None:
        return pace.speed
    return min(pace.speed, gentle_scale(scene.robot, motion, pace.T_flange_tool, pace.acceleration))


def _duration(scene: CollisionScene, motion: Motion, pace: Pace) -> float:
    return motion.duration / _scale(scene, motion, pace)


def _sampled(scene: CollisionScene, motion: Motion, pace: Pace, name: str) -> Trajectory:
    return Trajectory(name, *motion.sampled(pace.dt, _scale(scene, motion, pace)), pace.dt)
