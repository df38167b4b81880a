"""A signed distance field of the CAD on a grid, exact at the nodes, for thousands of cheap look-ups.

Each node stores the signed distance (negative inside) and its gradient; between nodes the field of the nearest node
is continued as a plane, which is exact wherever the nearest surface is flat and costs one gather of four numbers.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
import trimesh
from scipy.ndimage import label
from scipy.spatial import cKDTree
from torch import Tensor

MARGIN = 0.15
"""Width of the field around the part, in units."""

MAX_NODES = 220_000
CELLS = 72
"""Grid cells to a unit, fewer where the grid would have more than MAX_NODES nodes."""


class FieldArrays(NamedTuple):
    """`DistanceField` for loops compiled by numba: table (n, 4), origin (3,), step, shape (3,) int64."""

    table: np.ndarray
    origin: np.ndarray
    step: np.float32
    shape: np.ndarray


@dataclass(frozen=True)
class DistanceField:
    """Look-up table of signed distance and gradient in normalised CAD coordinates.

    Attributes:
        table: (n, 4) offset c and unit gradient g at each node, in C order of x, y, z; the distance is c + g . x.
        origin: (3,) the first node; step: distance of the nodes; shape: nodes along x, y, z.
    """

    table: Tensor
    origin: Tensor
    step: float
    shape: tuple[int, int, int]

    @functools.cached_property
    def arrays(self) -> FieldArrays:
        """The field for loops compiled by numba."""
        return FieldArrays(self.table.numpy(), self.origin.numpy(), np.float32(self.step), np.array(self.shape))

    def look_up(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Signed distance (...) and gradient (..., 3) at normalised CAD points (..., 3)."""
        flat = points.reshape(-1, 3)
        cell = ((flat - self.origin) * (1.0 / self.step)).round_().clamp_(min=0)
        cell = torch.minimum(cell, torch.tensor(self.shape, dtype=torch.float32) - 1)
        strides = torch.tensor([self.shape[1] * self.shape[2], self.shape[2], 1.0])
        row = self.table.index_select(0, (cell @ strides).long())
        gradient = row[:, 1:]
        distance = torch.linalg.vecdot(gradient, flat) + row[:, 0]
        return distance.reshape(points.shape[:-1]), gradient.reshape(points.shape)

    def nodes(self) -> Tensor:
        """Positions (n, 3) of the nodes."""
        axes = [self.origin[a] + self.step * torch.arange(self.shape[a]) for a in range(3)]
        return torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)

    @staticmethod
    def of(mesh: trimesh.Trimesh) -> DistanceField:
        """Field of a watertight mesh in normalised units."""
        low, high = mesh.bounds[0] - MARGIN, mesh.bounds[1] + MARGIN
        step = max(1.0 / CELLS, float((np.prod(high - low) / MAX_NODES) ** (1 / 3)))
        shape = np.ceil((high - low) / step).astype(int) + 1
        axes = [low[a] + step * np.arange(shape[a]) for a in range(3)]
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        distance, gradient = signed_distance(mesh, nodes)
        turn = np.where(
            np.where(distance < 0, -1.0, 1.0) == _far_side(distance.reshape(shape), 0.02).reshape(-1), 1.0, -1.0
        )
        distance, gradient = distance * turn, gradient * turn[:, None]
        offset = distance - (gradient * nodes).sum(1)
        table = torch.from_numpy(np.column_stack([offset, gradient]).astype(np.float32))
        return DistanceField(
            table, torch.from_numpy(low.astype(np.float32)), step, (int(shape[0]), int(shape[1]), int(shape[2]))
        )


def signed_distance(mesh: trimesh.Trimesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance (n,) and unit gradient (n, 3): nearest surface samples first, then their triangles exactly."""
    samples, face = trimesh.sample.sample_surface(mesh, 60_000, seed=0)
    spacing = float(np.sqrt(mesh.area / len(samples)))
    tree = cKDTree(samples)
    rough, nearest = tree.query(points)
    normals = np.asarray(mesh.face_normals)
    closest = np.asarray(samples)[nearest]
    outward = normals[face[nearest]]
    # far away the nearest sample will do; near the surface take the nearest triangle, and at an edge all that share it
    close = np.flatnonzero(rough < 4 * spacing + 0.025)
    _, near = tree.query(points[close], k=8)
    candidates = face[near]
    triangles = np.asarray(mesh.triangles)[candidates.reshape(-1)]
    repeated = np.repeat(points[close], near.shape[1], axis=0)
    feet = trimesh.triangles.closest_point(triangles, repeated).reshape(len(close), -1, 3)
    d = np.linalg.norm(points[close, None] - feet, axis=-1)
    best = d.argmin(1)
    closest[close] = feet[np.arange(len(close)), best]
    tied = d <= d.min(1, keepdims=True) + 1e-6
    outward[close] = np.einsum("nk,nkc->nc", tied, normals[candidates])
    offset = points - closest
    length = np.linalg.norm(offset, axis=1)
    sign = np.where((offset * outward).sum(1) < 0, -1.0, 1.0)
    on_surface = length < 1e-5
    gradient = np.where(on_surface[:, None], outward, offset * sign[:, None])
    gradient /= np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-12)
    return sign * length, gradient


def _far_side(distance: np.ndarray, near: float) -> np.ndarray:
    """Sign of the distance on a grid: as given within `near` of the surface, beyond it by what connects to the border.

    Beside an edge, but far from it, the normal of the nearest sample may be that of the wrong one of its two faces.
    """
    side = np.where(distance < 0, -1.0, 1.0)
    parts, count = label(np.abs(distance) > near)
    border = np.zeros(count + 1, dtype=bool)
    for axis in range(3):
        for end in (0, -1):
            border[np.unique(np.take(parts, end, axis=axis))] = True
    outside = np.where(border, 1.0, -1.0)[parts]
    return np.where(parts > 0, outside, side)
