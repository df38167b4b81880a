"""Recovery: retreat from an aborted pick along paths that were free just before, and out of a collision."""

from __future__ import annotations

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.physics.grip import release
from pickproof.cell.physics.trajectory_execution import MotionLog, execute, wait
from pickproof.grasping.candidates import GraspCandidate
from pickproof.scenarios.picking.stages import PlannedPick
from pickproof.scenarios.picking.workcell import Workcell

FALL_TIME = 0.1  # [s] for the held workpiece to leave the gripper
RETREAT_SPEED = 0.2  # share of the speed of the arrival
COMING_LOOSE = 0.15  # [s] of the path in which the arm may still press on the obstacle


def back_off(cell: Workcell, pick: PlannedPick) -> MotionLog:
    """From the grasp back to where the gripper had left the last place, with the gripper released.

    It does not descend to its waiting pose: the workpiece released there has moved and may be under the fingers.
    """
    world, arm, limit = cell.world, cell.arm, cell.scenario.limits.contact_force_N
    log = release(world, arm, pick.candidate.opening).log + wait(world, arm, FALL_TIME)
    return log + execute(world, arm, pick.plan.approach.q[pick.plan.cleared :][::-1], stop_above=limit)


def put_back(cell: Workcell, pick: PlannedPick) -> MotionLog:
    """From the place back to where the workpiece was taken; release it there, and `back_off`."""
    world, arm, limit = cell.world, cell.arm, cell.scenario.limits.contact_force_N
    log = execute(world, arm, pick.plan.carry.q[::-1], stop_above=limit)
    if not log.stopped:
        log += execute(world, arm, pick.plan.lift.q[::-1], stop_above=limit)
    return log if log.stopped else log + back_off(cell, pick)


def recover(cell: Workcell, candidate: GraspCandidate, way_in: Array, way_on: Array, opening: float) -> MotionLog:
    """Out of a collision that stopped the arm: slowly back along its path, to the start of `way_in`.

    At first the arm may still press on the obstacle. A held workpiece is released where it was taken.

    Args:
        way_in: (n, 6) joint vectors that were commanded on the way to the grasp; way_on: (m, 6) those after it, none
            where the arm was stopped before.
        opening: of the jaws there, in [m].

    Returns:
        A log of the retreat only; `stopped` where the arm did not get back.
    """
    world, arm, limit = cell.world, cell.arm, cell.scenario.limits.contact_force_N
    loose = round(COMING_LOOSE / world.dt)
    log = MotionLog()
    for rows in (way_on, way_in):
        if len(rows) < 2:
            continue
        back = rows[::-1]
        if log.rows == 0:
            log += execute(world, arm, _slowed(np.concatenate([arm.q[None], back[:loose]])))
            back = back[min(loose, len(back)) - 1 :]
        if not log.stopped and len(back) > 1:
            log += execute(world, arm, _slowed(back), stop_above=limit)
        if log.stopped:
            return log
        if rows is way_on:
            log += release(world, arm, candidate.opening).log + wait(world, arm, FALL_TIME)
    arm.hold_jaws(opening)
    return log


def _slowed(rows: Array) -> Array:
    """Joint vectors (n, 6) at RETREAT_SPEED, from rest to rest."""
    steps = max(round((len(rows) - 1) / RETREAT_SPEED), 2)
    s = np.linspace(0.0, 1.0, steps + 1)
    at = (len(rows) - 1) * s * s * (3.0 - 2.0 * s)
    return np.stack([np.interp(at, np.arange(len(rows)), column) for column in rows.T], axis=1)
