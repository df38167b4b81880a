"""A pick as target points for a controller program."""

from __future__ import annotations

from typing import Any

import numpy as np

from pickproof.cell.frames import Array
from pickproof.robots.kinematics.inverse import flange_poses
from pickproof.robots.kinematics.model import RobotModel
from pickproof.robots.motion.trajectory import Trajectory
from pickproof.robots.plan.pick_plan import PickPlan
from pickproof.robots.program.tp_program import Waypoint

THROUGH = 100  # CNT of points that are passed without a stop
VIAS = 6  # points taken of a free move that is not direct


def waypoints_of(
    robot: RobotModel, plan: PickPlan, T_flange_tool: Array, straight: float, straight_place: float
) -> list[Waypoint]:
    """The points of a pick: above the last place, before, at and after the grasp, before and at the place, and home.

    Speeds are the means over each section. The controller interpolates between the points by its own method, so the
    program equals the planned motion on its lines and is close to it in between.

    Args:
        straight: length in [m] of the lines into and out of the grasp that a program must keep; straight_place: of that
            into the place.
    """
    approach, carry = plan.approach, plan.carry
    stops: list[tuple[Trajectory, list[tuple[int, bool]]]] = [
        (
            approach,
            _free(approach, plan.cleared, before_end(robot, approach, T_flange_tool, straight), plan.methods[0]),
        ),
        (
            plan.lift,
            [(_first_beyond(robot, plan.lift.q, T_flange_tool, straight), True), (len(plan.lift.q) - 1, False)],
        ),
        (carry, _free(carry, 0, before_end(robot, carry, T_flange_tool, straight_place), plan.methods[1])),
    ]
    if len(plan.leave.q) > 1:
        stops.append((plan.leave, [(len(plan.leave.q) - 1, False)]))
    found = [Waypoint(approach.q[0], "J", 1.0)]
    for trajectory, points in stops:
        before = 0
        for index, line in points:
            last = index == len(trajectory.q) - 1 and trajectory is not plan.lift
            gripper = {id(approach): "close", id(carry): "open"}.get(id(trajectory), "") if last else ""
            speed = _speed(robot, trajectory, T_flange_tool, before, index, line)
            cnt = None if last else THROUGH
            found.append(Waypoint(trajectory.q[index], "L" if line else "J", speed, cnt, gripper))  # type: ignore[arg-type]
            before = index
    return found


def _free(trajectory: Trajectory, cleared: int, line: int, method: str) -> list[tuple[int, bool]]:
    """Samples of a free move that ends in a line from sample `line` on, and whether each is reached on a line."""
    points = [(cleared, True)] if cleared else []
    if method != "direct":
        points += [(int(i), False) for i in np.linspace(cleared, line, VIAS + 2)[1:-1]]
    return [*points, (line, False), (len(trajectory.q) - 1, True)]


def before_end(robot: RobotModel, trajectory: Trajectory, T_flange_tool: Array, distance: float) -> int:
    """Index of the sample from which on the TCP is within `distance` [m] of where it ends."""
    return len(trajectory.q) - 1 - _first_beyond(robot, trajectory.q[::-1], T_flange_tool, distance)


def _first_beyond(robot: RobotModel, q: Array, T_flange_tool: Array, distance: float) -> int:
    """Index of the last of q (n, 6) before the TCP is farther than `distance` [m] from where it began."""
    points = _points(robot, q, T_flange_tool)
    beyond = np.linalg.norm(points - points[0], axis=1) > distance
    return max(int(np.argmax(beyond)) - 1, 1) if beyond.any() else len(q) - 1


def _points(robot: RobotModel, q: Array, T_flange_tool: Array) -> Array:
    return np.asarray((flange_poses(robot, q) @ T_flange_tool)[:, :3, 3])


def _speed(robot: RobotModel, trajectory: Trajectory, T_flange_tool: Array, a: int, b: int, line: bool) -> float:
    """Mean over samples a to b: of the TCP in [m/s] on a line, else share of the slowest joint's speed limit."""
    seconds = max(b - a, 1) * trajectory.dt
    if line:
        ends = _points(robot, trajectory.q[[a, b]], T_flange_tool)
        return max(float(np.linalg.norm(ends[1] - ends[0])) / seconds, 0.001)
    share = float((np.abs(trajectory.q[b] - trajectory.q[a]) / robot.velocity).max()) / seconds
    return float(np.clip(share, 0.01, 1.0))


def waypoints_to_json(waypoints: list[Waypoint]) -> list[dict[str, Any]]:
    """Waypoints in the form stored in a record; angles in [rad]."""
    return [
        {
            "q": [round(float(x), 7) for x in w.q],
            "motion": w.motion,
            "speed": round(w.speed, 4),
            "cnt": w.cnt,
            "gripper": w.gripper,
        }
        for w in waypoints
    ]


def waypoints_from_json(rows: list[dict[str, Any]]) -> list[Waypoint]:
    """The inverse of `waypoints_to_json`."""
    return [Waypoint(np.array(r["q"]), r["motion"], r["speed"], r["cnt"], r["gripper"]) for r in rows]
