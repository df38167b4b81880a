"""Detection of double picks by weight, while the arm stands still over the place.

The noise of readings is independent, so the mean of n readings has noise / sqrt(n). The number n is chosen so that one
workpiece can be distinguished from two; where that takes longer than `wrist.PATIENCE`, there is no decision.
"""

from __future__ import annotations

import math

import numpy as np

from pickproof.cell.physics.force_torque_sensor import PATIENCE, QUIET, weigh, weigh_swinging
from pickproof.cell.physics.trajectory_execution import MotionLog, execute
from pickproof.cell.physics.world import GRAVITY
from pickproof.robots.motion.trajectory import Trajectory
from pickproof.scenarios.config.scenario import WristConfig
from pickproof.scenarios.picking.stages import Weighed
from pickproof.scenarios.picking.workcell import Workcell

RAISED = 0.06  # [m] over a place, clear of what lies there
STEADY = 0.1  # share of a workpiece's weight: a larger spread of the reading means that it may swing
SIGMAS = 4.5
"""Standard deviations of the mean reading within half a workpiece's weight, and within what `double_above` leaves."""


def readings(wrist: WristConfig, mass: float) -> int:
    """Number of readings that distinguish one workpiece of `mass` [kg] from two; 0 where they exceed PATIENCE.

    With `double_above` 1.7, one workpiece is then at least 1.4 SIGMAS below the limit and two 0.6 SIGMAS above it: one
    is taken for two in less than one of 10^9 weighings, and two for one in 1.4 % at most, as all four readings must
    exceed the limit.
    """
    apart = min(0.5, wrist.double_above - 1) * mass * GRAVITY
    n = max(math.ceil((SIGMAS * wrist.noise_N / apart) ** 2), 1)
    return n if n == 1 or n * wrist.seconds <= PATIENCE + 1e-9 else 0


def count_by_weight(cell: Workcell, carry: Trajectory, rng: np.random.Generator) -> tuple[Weighed, MotionLog]:
    """Whether the load of the arm, which stands still over the place, weighs as much as several workpieces.

    A workpiece that leans on the bin or on a neighbour also loads the wrist. So a load that seems too heavy is raised
    along the path of `carry`, weighed again, and lowered.
    """
    if not readings(cell.scenario.wrist, cell.workpiece.mass):
        return Weighed.CANNOT_TELL, MotionLog()
    heavy, log = _heavy(cell, rng)
    if not heavy:
        return Weighed.ONE, log
    limit = cell.scenario.limits.contact_force_N
    up = cell.carrier.raised(cell, carry, RAISED)
    log += execute(cell.world, cell.arm, up, stop_above=limit)
    heavy, weighing = _heavy(cell, rng)
    log += weighing
    if not log.stopped:
        log += execute(cell.world, cell.arm, up[::-1], stop_above=limit)
    return Weighed.SEVERAL if heavy else Weighed.ONE, log


def _heavy(cell: Workcell, rng: np.random.Generator) -> tuple[bool, MotionLog]:
    """Number of workpieces by weight, with the noise of the scenario's wrist sensor from `rng`; no ground truth is
    used.

    A load that seems too heavy or varies may swing, which can double or halve the momentary weight.
    """
    wrist, mass = cell.scenario.wrist, cell.workpiece.mass
    n = readings(wrist, mass)
    noise = wrist.noise_N / GRAVITY / math.sqrt(n)
    limit, steady = wrist.double_above * mass, STEADY * mass
    reading = weigh(cell.world, cell.arm, n * wrist.seconds)
    log = reading.log
    heavy = reading.mass + noise * rng.standard_normal() > limit
    if heavy or reading.spread > steady:
        quiet = QUIET if n == 1 else max(QUIET, n * wrist.seconds)
        reading = weigh_swinging(cell.world, cell.arm, steady, quiet)
        log += reading.log
        heavy = reading.mass + noise * rng.standard_normal() > limit
    return heavy, log
