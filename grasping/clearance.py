"""Room for the open gripper: against the bin exactly, against the rest of the heap by the scene cloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cell.bin import Bin, Box
from cell.frames import Array, apply, invert
from cell.workpiece import Workpiece

WALL_MARGIN = 0.0008  # [m] kept from walls and floor
POINT_MARGIN = 0.0005  # [m] kept from the cloud
VOXEL = 0.0025  # [m] spacing to which the cloud is thinned
OWN = 0.003  # [m] cloud points this close to the estimated workpiece are its own


_GRID = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1], indexing="ij"), -1).reshape(-1, 3)
OUTLINE = _GRID[np.abs(_GRID).sum(1) >= 2].astype(float)
"""Corners and edge middles (20, 3) of the box from -1 to 1."""


def thin(points: Array, voxel: float = VOXEL) -> Array:
    """One point of every occupied voxel; deterministic."""
    if len(points) == 0:
        return points
    _, first = np.unique(np.floor(points / voxel).astype(np.int64), axis=0, return_index=True)
    return points[np.sort(first)]


def without_workpiece(points: Array, T_world_part: Array, workpiece: Workpiece, margin: float = OWN) -> Array:
    """The points (n, 3) that do not lie on the workpiece at its estimated pose."""
    local = apply(invert(T_world_part), points)
    own = np.zeros(len(points), dtype=bool)
    for size, T_part_box in workpiece.piece_boxes():
        p = apply(invert(T_part_box), local)
        own |= (np.abs(p) < np.asarray(size) / 2 + margin).all(axis=1)
    return points[~own]


@dataclass(frozen=True)
class OpenGripper:
    """The gripper at one opening, in the tool frame: its boxes are parallel to that frame.

    Attributes:
        centres, halves: (b, 3) of its boxes in [m].
        outline: (k, 3) corners and middles of edges of all boxes.
        reach: distance in [m] from the TCP to the farthest corner.
    """

    centres: Array
    halves: Array
    outline: Array
    reach: float

    @staticmethod
    def of(boxes: Sequence[Box]) -> OpenGripper:
        """From the gripper's boxes in the tool frame."""
        centres = np.stack([b.T_world_box[:3, 3] for b in boxes])
        halves = np.stack([np.asarray(b.size) / 2 for b in boxes])
        outline = (centres[:, None] + OUTLINE[None] * halves[:, None]).reshape(-1, 3)
        return OpenGripper(centres, halves, outline, float(np.linalg.norm(outline, axis=1).max()))

    def hits_points(self, Ts_world_tool: Array, points: Array, margin: float = POINT_MARGIN) -> np.ndarray:
        """(n,) bool: a point (k, 3) in the world is inside the gripper at a tool pose (n, 4, 4)."""
        if len(points) == 0:
            return np.zeros(len(Ts_world_tool), dtype=bool)
        local = apply(invert(Ts_world_tool), points)
        inside = np.zeros(local.shape[:2], dtype=bool)
        for centre, half in zip(self.centres, self.halves, strict=True):
            inside |= (np.abs(local - centre) < half + margin).all(axis=-1)
        return np.asarray(inside.any(axis=1))

    def hits_bin(self, Ts_world_tool: Array, bin: Bin) -> np.ndarray:
        """(n,) bool: part of the outline is in a wall, under the floor, or outside the walls below the rim."""
        lx, ly, lz = bin.inner
        p = apply(invert(bin.T_world_bin) @ Ts_world_tool, self.outline)
        low = p[..., 2] < lz + WALL_MARGIN
        beyond = (np.abs(p[..., 0]) > lx / 2 - WALL_MARGIN) | (np.abs(p[..., 1]) > ly / 2 - WALL_MARGIN)
        return np.asarray(((low & beyond) | (p[..., 2] < WALL_MARGIN)).any(axis=1))
