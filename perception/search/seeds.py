"""Scene points at which poses are tried: measured points with a normal, one a voxel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickproof.perception.ps6d.point_hierarchy import voxel_sample
from pickproof.perception.refinement.depth_surface import SurfaceMap

FINER = 0.8
"""Factor of the voxel where seeds are too few."""
FINEST = 0.3
"""Least voxel, as a share of the one that is set."""


@dataclass(frozen=True)
class Seeds:
    """Measured points: positions and unit normals towards the camera, both (n, 3) float32, in units."""

    points: np.ndarray
    normals: np.ndarray

    def __len__(self) -> int:
        return len(self.points)


class SeedPixels:
    """The pixels of a frame that can be seeds."""

    def __init__(self, scene: SurfaceMap) -> None:
        table = scene.table.numpy()
        usable = np.flatnonzero((table[:, 2] > 0) & (table[:, 5] != 0))
        self._rows = np.ascontiguousarray(table[usable, :6])
        self._points = self._rows[:, :3].astype(np.float64)

    def one_a_voxel(self, voxel: float, rng: np.random.Generator, least: int = 0, most: int | None = None) -> Seeds:
        """Seeds in voxels of that size; smaller ones where there are fewer than `least`, evenly `most` of them."""
        smallest = FINEST * voxel
        index = voxel_sample(self._points, voxel, rng)
        while len(index) < least and voxel * FINER >= smallest and len(index) < len(self._points):
            voxel *= FINER
            index = voxel_sample(self._points, voxel, rng)
        if most is not None and len(index) > most:
            index = index[np.sort(rng.choice(len(index), most, replace=False))]
        rows = self._rows[index]
        return Seeds(rows[:, :3].copy(), rows[:, 3:6].copy())
