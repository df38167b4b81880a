"""Over the place, where the arm stands still: how many workpieces came along, by their weight."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cell.execute import MotionLog
from cell.world import GRAVITY
from cell.wrist import weigh

if TYPE_CHECKING:
    from scenarios.workcell import Workcell

FALL_TIME = 0.1  # [s] for the workpieces to leave the jaws


def comes_up_double(cell: Workcell, rng: np.random.Generator) -> tuple[bool, MotionLog]:
    """Whether what hangs on the arm, which stands still, weighs as much as several workpieces.

    A measurement with the noise of the scenario's wrist sensor, from `rng`; no identities of workpieces enter.
    """
    wrist = cell.scenario.wrist
    mass, log = weigh(cell.world, cell.arm, wrist.seconds)
    mass += wrist.noise_N / GRAVITY * rng.standard_normal()
    return mass > wrist.double_above * cell.workpiece.mass, log
