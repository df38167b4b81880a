"""A free move that ends on a straight tool line: the shape of every approach, carry and return."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from cell.frames import Array
from robots.collision import CollisionScene, Contact
from robots.search import Method, connect_quickly, search
from robots.timing import JointPath
from robots.trajectory import (
    Trajectory,
    concatenate,
    follow,
    gentle,
    join_line,
    joint_move,
    joint_path,
    tool_acceleration,
)

Joined = tuple[Trajectory, Method]

FLY_BY = (1.0, 0.75, 0.5, 0.25)  # speeds tried at the junction, as fractions of the line's own top speed


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
    found = connect_quickly(scene, q0, line.start)
    if found is None and seed is not None:
        path = search(scene, q0, line.start, seed)
        found = None if path is None else (path, "search")
    if found is None:
        return describe(scene.path_contact(np.stack([q0, line.start])))
    waypoints, method = found
    if method == "direct":
        flying = _fly(scene, q0, line, pace, name)
        if flying is not None:
            return flying, method
    way = _along(scene, waypoints, pace, name)
    return concatenate(name, [way, run(scene, line, pace, name)]), method


def run(scene: CollisionScene, line: JointPath, pace: Pace, name: str) -> Trajectory:
    """Along a line from rest to rest."""

    def make(scale: float) -> Trajectory:
        return follow(scene.robot, line, scale, pace.dt, name)

    if pace.acceleration is None:
        return make(pace.speed)
    return gentle(make, scene.robot, pace.T_flange_tool, pace.acceleration, pace.speed)


def describe(contact: Contact | None) -> str:
    """What a contact says to a reader."""
    return "nothing" if contact is None else f"{contact[0]} touches {contact[1]}"


def _fly(scene: CollisionScene, q0: Array, line: JointPath, pace: Pace, name: str) -> Trajectory | None:
    """The quickest free trajectory through the junction without a stop, if it beats stopping there."""
    robot = scene.robot
    stop = joint_move(robot, q0, line.start, pace.speed, pace.dt)
    options = [(_slow(scene, stop, pace) + _slow(scene, follow(robot, line, pace.speed, pace.dt), pace), 0.0, stop, 0)]
    for fraction in FLY_BY:
        joined = join_line(robot, q0, line, fraction, pace.speed, pace.dt, name)
        if joined is not None:
            options.append((_slow(scene, joined[0], pace), fraction, *joined))
    for _, fraction, trajectory, junction in sorted(options, key=lambda o: o[:2]):
        if fraction == 0.0:
            return None
        if not scene.free_path(trajectory.q[: junction + 1]):
            continue
        if pace.acceleration is None:
            return trajectory

        def make(scale: float, fraction: float = fraction) -> Trajectory:
            joined = join_line(robot, q0, line, fraction, scale, pace.dt, name)
            assert joined is not None  # slower in time, the same path
            return joined[0]

        return gentle(make, robot, pace.T_flange_tool, pace.acceleration, pace.speed)
    return None


def _along(scene: CollisionScene, waypoints: Array, pace: Pace, name: str) -> Trajectory:
    """Through waypoints: on a smooth curve where it is free and quicker, else straight with a stop at each."""

    def stopping(scale: float) -> Trajectory:
        return joint_path(scene.robot, waypoints, scale, pace.dt, name)

    def smooth(scale: float) -> Trajectory:
        return follow(scene.robot, curve, scale, pace.dt, name)

    make = stopping
    if len(waypoints) > 2:
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1))])
        curve = JointPath(CubicSpline(s / s[-1], waypoints, axis=0))
        q = curve.spline(np.linspace(0.0, 1.0, 100))
        quicker = smooth(pace.speed).duration < stopping(pace.speed).duration
        if quicker and scene.robot.within_limits(q).all() and scene.free_path(q):
            make = smooth
    if pace.acceleration is None:
        return make(pace.speed)
    return gentle(make, scene.robot, pace.T_flange_tool, pace.acceleration, pace.speed)


def _slow(scene: CollisionScene, trajectory: Trajectory, pace: Pace) -> float:
    """Duration in [s] after it is slowed down to the acceleration limit."""
    if pace.acceleration is None:
        return trajectory.duration
    peak = tool_acceleration(scene.robot, trajectory, pace.T_flange_tool)
    return trajectory.duration * max(1.0, float(np.sqrt(peak / pace.acceleration)))
