"""Ways back from a pick that is given up, along the ways that were free a moment ago."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cell.execute import MotionLog, execute, wait
from cell.grip import release
from grasping.candidates import GraspCandidate
from robots.plan import PickPlan

if TYPE_CHECKING:
    from scenarios.workcell import Workcell

FALL_TIME = 0.1  # [s] for what was held to leave the gripper


def back_off(cell: Workcell, candidate: GraspCandidate, plan: PickPlan, opening: float) -> MotionLog:
    """From the grasp back to where the motion began, the gripper released.

    Args:
        opening: of the jaws where the motion began, in [m].
    """
    world, arm, limit = cell.world, cell.arm, cell.scenario.limits.contact_force_N
    log = release(world, arm, candidate.opening).log + wait(world, arm, FALL_TIME)
    log += execute(world, arm, plan.approach.q[plan.cleared :][::-1], stop_above=limit)
    if not log.stopped:
        arm.hold_jaws(opening)
        log += execute(world, arm, plan.approach.q[: plan.cleared][::-1], stop_above=limit)
    return log


def put_back(cell: Workcell, candidate: GraspCandidate, plan: PickPlan, opening: float) -> MotionLog:
    """From the place with what is held to where it was taken, let it go, and `back_off`."""
    world, arm, limit = cell.world, cell.arm, cell.scenario.limits.contact_force_N
    log = execute(world, arm, plan.carry.q[::-1], stop_above=limit)
    if not log.stopped:
        log += execute(world, arm, plan.lift.q[::-1], stop_above=limit)
    return log if log.stopped else log + back_off(cell, candidate, plan, opening)
