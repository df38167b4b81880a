"""What the collision pieces of a workpiece cost: processor time of a physics step of a small pile."""

from __future__ import annotations

import time
from contextlib import closing

import numpy as np

from pickproof.cell.geometry.bin import Bin
from pickproof.cell.physics.world import World, random_pose
from pickproof.cell.workpiece.workpiece import Workpiece

PILE = 8
STEPS = 240
"""Half a second, the pile having fallen for as long before."""


def step_cost(workpiece: Workpiece, iterations: int) -> float:
    """Processor time [s] of one step with PILE awake workpieces in contact, on this machine."""
    rng = np.random.default_rng(0)
    reach = float(np.linalg.norm(workpiece.extents))
    with closing(World(solver_iterations=iterations)) as world:
        world.add_bin(Bin("pile", (1.5 * reach, 1.5 * reach, reach), 0.01, (0.0, 0.0, 0.0)))
        for i in range(PILE):
            world.add_part(workpiece, random_pose((0.0, 0.0, (0.6 + i) * reach), (0.2 * reach, 0.2 * reach), rng))
        world.step(STEPS)
        begun = time.process_time()
        world.step(STEPS)
        return (time.process_time() - begun) / STEPS
