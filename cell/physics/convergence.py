"""How many iterations the contact solver needs for a part between the links of a gripper.

Bullet solves contacts one after the other (projected Gauss-Seidel). A light part of mass m between two fingers of mass
M is pushed by the left one and by the right one; with 1/m + 1/M on the diagonal of that system and -1/m beside it, each
sweep leaves the share (M / (m + M))^2 of the error; to leave the share e takes ln(1 / e) / (2 ln(1 + m / M)) sweeps.
A light finger between a heavy part and the gear that keeps the fingers symmetric is the same system with m and M
exchanged. What pushes a light part, the motors, starts anew with every grip: LIGHT is the threshold of the solver's
residual, some 8 M / m sweeps. The weight of a heavy part changes little from step to step, and each step begins with
the forces of the last: a tenth, some m / M sweeps, is enough, as a scan from 0.3 to 10 kg showed
(docs/explanation/physics.md).
"""

from __future__ import annotations

import math

from pickproof.cell.grippers.base import Gripper
from pickproof.cell.workpiece.workpiece import Workpiece

FEWEST, MOST = 50, 2000
"""Iterations: what arm and heap need by themselves, and what one may wait for."""
LIGHT, HEAVY = 1e-7, 0.1
"""Share of the error that may be left of the forces on a light part, and on a heavy one."""


def solver_iterations(workpiece: Workpiece, gripper: Gripper) -> int:
    """Iterations under which the grip of a workpiece is converged; a solver that is done earlier stops by itself."""
    ratio = workpiece.mass / max(link.mass for link in gripper.links())
    light = math.log(1 / LIGHT) / (2 * math.log1p(ratio))
    heavy = math.log(1 / HEAVY) / (2 * math.log1p(1 / ratio))
    return min(max(FEWEST, math.ceil(light), math.ceil(heavy)), MOST)
