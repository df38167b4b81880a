"""Which poses a measured point lies on: every point keeps its best few, and what no point keeps is given up."""

from __future__ import annotations

import numba
import numpy as np

from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.refinement.numba_kernels import distance_at, turned_back
from pickproof.perception.search.poses import Poses
from pickproof.perception.search.seeds import Seeds

LEAST_FACING = 0.5
"""Least cosine between the normal of a point and that of the surface it lies on."""
SLACK = 0.05
"""Beyond the farthest point of the CAD, in units, at which a point is not looked up any more."""


def poses_at(seeds: Seeds, poses: Poses, shape: ShapeModel, reach: float, most: int) -> np.ndarray:
    """(n, most) indices of the first poses on whose surface each point lies within `reach` units; -1 for none.

    Args:
        poses: best first.
    """
    farthest = np.float32((np.linalg.norm(shape.points, axis=1).max() + SLACK) ** 2)
    found: np.ndarray = _cover(
        poses.rotations.numpy(), poses.positions.numpy(), seeds.points, seeds.normals, np.float32(reach),
        *shape.field.arrays, farthest, most,
    )  # fmt: skip
    return found


def kept_by_points(at: np.ndarray) -> np.ndarray:
    """Indices of the poses that any point of `poses_at` keeps, in their order."""
    return np.unique(at[at >= 0])


@numba.njit(cache=True)
def _cover(  # type: ignore[no-untyped-def]
    R, t, points, normals, reach, field, field_origin, field_step, field_shape, farthest, most
):
    found = np.full((len(points), most), -1, np.int64)
    for i in range(len(points)):
        count = 0
        for h in range(len(R)):
            x, y, z = points[i, 0] - t[h, 0], points[i, 1] - t[h, 1], points[i, 2] - t[h, 2]
            if x * x + y * y + z * z > farthest:
                continue
            qx, qy, qz = turned_back(R, h, x, y, z)
            distance, gx, gy, gz = distance_at(field, field_origin, field_step, field_shape, qx, qy, qz)
            if abs(distance) > reach:
                continue
            nx, ny, nz = turned_back(R, h, normals[i, 0], normals[i, 1], normals[i, 2])
            if nx * gx + ny * gy + nz * gz < np.float32(LEAST_FACING):
                continue
            found[i, count] = h
            count += 1
            if count == most:
                break
    return found
