"""References for the time of a plan: a lower bound from the arm's limits, and a motion that stops at every point."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from pickproof.cell.frames import invert
from pickproof.robots.failure import Refusal
from pickproof.robots.kinematics.model import RobotModel
from pickproof.robots.motion.stop import Line, Pace
from pickproof.robots.motion.timing import Motion, rest_to_rest
from pickproof.robots.motion.trajectory import move_motion, path_motion
from pickproof.robots.plan.free_motion import duration
from pickproof.robots.plan.pick_plan import PickPlan
from pickproof.robots.plan.pick_request import PickRequest
from pickproof.robots.plan.pick_stops import UP


def lower_bound(robot: RobotModel, plan: PickPlan) -> float:
    """Least time in [s] from rest to rest at start, grasp and place (and end), in free space and without any line.

    The joints move at the arm's velocity, acceleration and jerk limits; the slowest joint decides.
    """
    stops = [plan.approach.q[0], plan.lift.q[0], plan.carry.q[-1], plan.leave.q[-1]]
    return float(sum(rest_to_rest(robot, b - a) for a, b in pairwise(stops)))


def stop_at_each(robot: RobotModel, request: PickRequest, plan: PickPlan) -> float:
    """Time in [s] of the pick with the whole of every line and a stop at both of its ends, obstacles ignored.

    Infinite where one of the lines, which the plan may have cut short, cannot be travelled to its end.
    """
    free, slow = request.free, request.slow
    T_flange_grasp = request.T_base_tool_grasp @ invert(request.hand.T_flange_tool)
    q_grasp, q_place = plan.lift.q[0], plan.carry.q[-1]
    T_flange_place = request.places.Ts_base_tool[plan.place] @ invert(request.hand.T_flange_tool)
    into = Line(robot, T_flange_grasp, q_grasp, request.way_back)
    out = Line(robot, T_flange_grasp, q_grasp, request.lines.retract * np.array(request.lines.retract_direction))
    down = Line(robot, T_flange_place, q_place, request.lines.place * UP)
    paths = [line.path for line in (into, out, down)]
    if any(isinstance(path, Refusal) for path in paths):
        return float("inf")
    above_grasp, lifted, above_place = (np.asarray(path.end) for path in paths if not isinstance(path, Refusal))
    # From the last place, with the same height above it as above this one.
    q_over = above_place if request.lines.depart else request.q_start
    motions: list[tuple[Motion, Pace]] = [
        (move_motion(robot, q_over, above_grasp), free),
        (move_motion(robot, lifted, above_place), slow),
    ]
    for path, pace in zip(paths, (free, slow, slow), strict=True):
        if not isinstance(path, Refusal):
            motions.append((path_motion(robot, path), pace))
            if path is paths[2] and request.lines.depart:
                motions.append((path_motion(robot, path), free))
    return sum(duration(robot, motion, pace) for motion, pace in motions)
