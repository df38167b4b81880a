"""Load limits of cups and magnets: how several share a load, and when one of them releases. Mechanics only.

Loads are those of the workpiece on the gripper, in the tool frame at the TCP: +z pulls the workpiece off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pickproof.cell.frames import Array

Limit = Literal["normal", "shear", "moment"]


@dataclass(frozen=True)
class Hold:
    """One cup or magnet that holds a workpiece.

    The contact force is `force` minus the pull. Its friction carries shear and torsion; the pressure under the rim
    carries bending, until the rim lifts off on one side.

    Attributes:
        centre: (x, y) in the tool frame [m].
        radius: of the rim or face [m].
        force: [N] that presses the workpiece on when nothing pulls.
        friction: coefficient between rim and workpiece.
        tilt_lever: [m] bending moment at which the rim lifts off, per newton of contact force.
        twist_lever: [m] lever of friction against torsion.
    """

    centre: tuple[float, float]
    radius: float
    force: float
    friction: float
    tilt_lever: float
    twist_lever: float

    def use(self, load: Array) -> dict[Limit, float]:
        """Load (6,) (force [N], moment about the centre [N m]) over limit, for each limit; the hold is lost above 1.

        Shear and torsion are carried by the same friction, hence together.
        """
        pressing = self.force - load[2]
        normal = float(load[2] / self.force)
        if pressing <= 0:
            return {"normal": max(normal, 1.0 + 1e-9), "shear": np.inf, "moment": np.inf}
        grip = self.friction * pressing
        shear = np.hypot(np.hypot(load[0], load[1]) / grip, load[5] / (grip * self.twist_lever))
        moment = np.hypot(load[3], load[4]) / (pressing * self.tilt_lever)
        return {"normal": normal, "shear": float(shear), "moment": float(moment)}

    def lost_by(self, load: Array) -> Limit | None:
        """The limit that a load (6,) exceeds, None where it holds; of several, the one that is reached first.

        The pull lowers all other limits, so these are compared as if there were no pull.
        """
        use = self.use(load)
        if max(use.values()) <= 1.0:
            return None
        unloaded = self.use(load * (1.0, 1.0, 0.0, 1.0, 1.0, 1.0)) | {"normal": use["normal"]}
        return max(unloaded, key=lambda limit: unloaded[limit])


def share(force: Array, moment: Array, holds: Sequence[Hold]) -> Array:
    """Loads (n, 6) on each hold of a load (force (3,) [N], moment (3,) [N m] about the TCP) on all of them.

    A rigid workpiece on equal elastic rims: each rim is a ring of springs, as stiff along z as across, so the workpiece
    moves by one small translation and rotation, and every rim carries the force of its own deflection.
    """
    n = len(holds)
    stiffness = np.zeros((n, 6, 6))  # of each, against translation and rotation at the TCP
    for k, hold in enumerate(holds):
        to_centre = _lever(hold.centre)
        bending = hold.radius**2 / 2  # of a ring of unit stiffness, about a diameter
        own = np.diag([1.0, 1.0, 1.0, bending, bending, 2 * bending])
        stiffness[k] = own @ to_centre
    total = sum(_lever(hold.centre).T @ stiffness[k] for k, hold in enumerate(holds))
    motion = np.linalg.solve(np.asarray(total), np.concatenate([force, moment]))
    return np.asarray(stiffness @ motion)


def _lever(centre: tuple[float, float]) -> Array:
    """(6, 6) from a small translation and rotation at the TCP to those at a centre."""
    x, y = centre
    J = np.eye(6)
    J[:3, 3:] = [[0.0, 0.0, -y], [0.0, 0.0, x], [y, -x, 0.0]]  # rotation x (x, y, 0)
    return J
