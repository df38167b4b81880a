"""Heights of the placed workpieces, which the arm avoids: computed from the releases, not measured."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pickproof.cell.frames import Array, apply, make_transform
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.robots.collision.scene import HeightField
from pickproof.scenarios.picking.heap_heightmap import raise_to

SAMPLES = 3000  # of a workpiece's surface
FINEST, CELLS = 0.004, 160  # [m] smallest edge of a cell; largest number of cells along the longer side


@dataclass
class Placed:
    """Workpieces released over the place bin, each in its pose in the gripper, lower by its fall.

    Attributes:
        bin: the place bin. surfaces: points (n, 3) in the world on every workpiece, in the order of placing.
    """

    bin: Bin
    workpiece: Workpiece
    surfaces: list[Array] = field(default_factory=list)

    def add(self, T_world_part: Array, fall: float) -> None:
        """Add a workpiece released at T_world_part (4, 4) that falls straight down by `fall` [m]."""
        surface = self.workpiece.sample_surface(SAMPLES, seed=7)[0]
        self.surfaces.append(apply(make_transform(t=(0.0, 0.0, -fall)) @ T_world_part, surface))

    def heights(self, last: bool = True) -> HeightField | None:
        """Ground of the placed workpieces; without the one still between the fingers if `last` is false."""
        surfaces = self.surfaces if last else self.surfaces[:-1]
        if not surfaces:
            return None
        T_world_bin, (lx, ly, _) = self.bin.T_world_bin, self.bin.inner
        half = np.abs(T_world_bin[:2, :2]) @ (lx / 2, ly / 2)
        low, step = T_world_bin[:2, 3] - half, max(FINEST, 2 * float(half.max()) / CELLS)
        nx, ny = np.maximum((2 * half / step).astype(int) + 1, 2)
        heights = np.full((ny, nx), T_world_bin[2, 3] - step)  # below the floor, which is a separate obstacle
        for points in surfaces:
            raise_to(heights, points, low, step)
        return HeightField(heights, float(low[0]), float(low[1]), step)
