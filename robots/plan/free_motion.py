"""One free motion between two stops, each with a straight tool line that leads to it or away from it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from pickproof.cell.frames import Array
from pickproof.robots.collision.scene import CollisionScene
from pickproof.robots.failure import Cause, Refusal
from pickproof.robots.kinematics.model import RobotModel
from pickproof.robots.motion.dynamics import bearable
from pickproof.robots.motion.stop import Pace, Stop
from pickproof.robots.motion.timing import JointPath, Motion
from pickproof.robots.motion.trajectory import Trajectory, concatenate, gentle_scale, move_motion, path_motion
from pickproof.robots.plan.blended_search import search_blended
from pickproof.robots.plan.path_search import Method, connect_quickly, search

FORMS_TRIED = 12  # forms of a blended motion to try where another kind of motion exists; twice as many where none does
Joined = tuple[Trajectory, Method]


def join(
    scene: CollisionScene, start: Stop, end: Stop, pace: Pace, seed: int | None, name: str, searched: bool = True
) -> Joined | Refusal:
    """Motion from one stop along its line, freely, and along the line to the other stop; or the reason why there is
    none.

    If no blended motion is free, the arm stops at the ends of the whole lines and moves straight, over a via point, or
    along a searched path.

    Args:
        seed: of the search; None for blended motions alone.
        searched: whether a path may be searched where no simpler motion is free.
    """
    scene.keep_clear(*(stop.air for stop in (start, end)))
    flying = search_blended(scene, start, end, pace, name, FORMS_TRIED if seed is None else 2 * FORMS_TRIED)
    if isinstance(flying, Trajectory):
        return flying, "direct"
    if seed is None:
        return flying
    paths: list[JointPath | None] = []
    for stop in (start, end):
        line = stop.line.path if stop.line else None
        if isinstance(line, Refusal):
            return line
        contact = line and scene.path_contact(line.spline(np.linspace(0.0, 1.0, 33)), stop.mode)
        if contact:
            return Refusal(Cause.COLLISION, contact=contact, on_line=True)
        paths.append(line)
    first, last = paths
    q0, q1 = first.end if first else start.q, last.end if last else end.q
    found = connect_quickly(scene, q0, q1)
    if found is None:
        path = search(scene, q0, q1, seed) if searched else None
        found = None if path is None else (path, "search")
    if found is None:
        return Refusal(Cause.COLLISION, contact=scene.path_contact(np.stack([q0, q1])))
    waypoints, method = found
    motions = [path_motion(scene.robot, first)] if first else []
    motions += _along(scene, waypoints, pace)
    if last:
        motions.append(path_motion(scene.robot, last.reversed()))
    scales = [_scale(scene.robot, motion, pace) for motion in motions]
    parts = []
    for motion, scale in zip(motions, scales, strict=True):
        if isinstance(scale, Refusal):
            return scale
        parts.append(Trajectory(name, *motion.sampled(pace.dt, scale), pace.dt))
    return concatenate(name, parts), method


def duration(robot: RobotModel, motion: Motion, pace: Pace) -> float:
    """Duration [s] of a motion within the limits; infinite where no speed keeps the torque limits."""
    scale = _scale(robot, motion, pace)
    return float("inf") if isinstance(scale, Refusal) else motion.duration / scale


def _along(scene: CollisionScene, waypoints: Array, pace: Pace) -> list[Motion]:
    """Motion through waypoints: on a smooth curve where it is free and faster, else straight with a stop at each."""
    robot = scene.robot
    stops = [move_motion(robot, a, b) for a, b in pairwise(waypoints)]
    if len(waypoints) > 2:
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1))])
        curve = JointPath(CubicSpline(s / s[-1], waypoints, axis=0))
        smooth = path_motion(robot, curve)
        q = curve.spline(np.linspace(0.0, 1.0, 200))
        quicker = duration(robot, smooth, pace) < sum(duration(robot, m, pace) for m in stops)
        if quicker and robot.within_limits(q).all() and scene.free_path(q):
            return [smooth]
    return stops


def _scale(robot: RobotModel, motion: Motion, pace: Pace) -> float | Refusal:
    """Share of the arm's full speed at which the tool's acceleration and all torques keep their limits."""
    scale = pace.speed
    if pace.acceleration is not None:
        scale = min(scale, gentle_scale(robot, motion, pace.T_flange_tool, pace.acceleration))
    return bearable(robot, motion, scale, pace.load)
