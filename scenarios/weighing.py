"""After the lift: how many workpieces came up, by their weight, and back with them where there are several."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cell.execute import MotionLog, execute, open_jaws, wait
from cell.world import GRAVITY
from cell.wrist import weigh
from grasping.candidates import GraspCandidate
from robots.plan import PickPlan

if TYPE_CHECKING:
    from scenarios.workcell import Workcell

FALL_TIME = 0.1  # [s] for the workpieces to leave the jaws


def comes_up_double(cell: Workcell, rng: np.random.Generator) -> tuple[bool, MotionLog]:
    """Whether what hangs on the arm, at rest after the lift, weighs as much as several workpieces.

    A measurement with the noise of the scenario's wrist sensor, from `rng`; no identities of workpieces enter.
    """
    wrist = cell.scenario.wrist
    mass, log = weigh(cell.world, cell.arm, wrist.seconds)
    mass += wrist.noise_N / GRAVITY * rng.standard_normal()
    return mass > wrist.double_above * cell.workpiece.mass, log


def put_back(cell: Workcell, candidate: GraspCandidate, plan: PickPlan) -> MotionLog:
    """Down along the lift, let go, and home along the approach: the ways that were free a moment ago."""
    limit = cell.scenario.limits.contact_force_N
    log = execute(cell.world, cell.arm, plan.lift.q[::-1], stop_above=limit)
    if log.stopped:
        return log
    log += open_jaws(cell.world, cell.arm, candidate.opening).log
    log += wait(cell.world, cell.arm, FALL_TIME)
    return log + execute(cell.world, cell.arm, plan.approach.q[::-1], stop_above=limit)
