"""Over the place, where the arm stands still: how many workpieces came along, by their weight."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cell.execute import MotionLog, execute
from cell.frames import Array
from cell.world import GRAVITY
from cell.wrist import weigh, weigh_swinging
from robots.plan import PickPlan
from robots.trajectory import joint_move
from robots.waypoints import before_end
from scenarios.free_motion import free_raise

if TYPE_CHECKING:
    from scenarios.workcell import Workcell

RAISED = 0.06  # [m] over a place, clear of what lies there
RAISING = 0.3  # share of the joints' limits
STEADY = 0.1  # of a workpiece's weight: spread of the reading over which it may swing


def comes_up_double(cell: Workcell, plan: PickPlan, rng: np.random.Generator) -> tuple[bool, MotionLog]:
    """Whether what hangs on the arm, which stands still over the place, weighs as much as several workpieces.

    What leans on the bin or on a neighbour there presses on the wrist too, so whatever seems too heavy is raised along
    the way it came, weighed once more, and lowered again where it was not.
    """
    heavy, log = _heavy(cell, rng)
    if not heavy:
        return False, log
    limit = cell.scenario.limits.contact_force_N
    up = _way_up(cell, plan)
    log += execute(cell.world, cell.arm, up, stop_above=limit)
    heavy, weighing = _heavy(cell, rng)
    log += weighing
    if not log.stopped:
        log += execute(cell.world, cell.arm, up[::-1], stop_above=limit)
    return heavy, log


def _way_up(cell: Workcell, plan: PickPlan) -> Array:
    """Joints (n, 6) from the place to RAISED over it."""
    q, dt = plan.carry.q, cell.world.dt
    if "motion" in cell.oracle:
        return free_raise(q[-1], RAISED, dt)
    high = before_end(cell.robot, plan.carry, cell.gripper.T_flange_tool, RAISED)
    return joint_move(cell.robot, q[-1], q[high], RAISING, dt).q


def _heavy(cell: Workcell, rng: np.random.Generator) -> tuple[bool, MotionLog]:
    """Measured with the noise of the scenario's wrist sensor, from `rng`; no identities of workpieces enter.

    What seems too heavy or pulls unevenly may swing, which within a moment can double its weight or take half of it.
    """
    wrist, mass = cell.scenario.wrist, cell.workpiece.mass
    noise = wrist.noise_N / GRAVITY
    limit, steady = wrist.double_above * mass, STEADY * mass
    reading = weigh(cell.world, cell.arm, wrist.seconds)
    log = reading.log
    heavy = reading.mass + noise * rng.standard_normal() > limit
    if heavy or reading.spread > steady:
        reading = weigh_swinging(cell.world, cell.arm, steady)
        log += reading.log
        heavy = reading.mass + noise * rng.standard_normal() > limit
    return heavy, log
