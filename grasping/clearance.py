"""Clearance of the open gripper: exact against the bin, by the scene cloud against the rest of the heap."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np

from pickproof.cell.frames import Array, apply, invert
from pickproof.cell.geometry.bin import Bin, Box
from pickproof.cell.point import moved
from pickproof.cell.workpiece.workpiece import Workpiece

WALL_MARGIN = 0.0008  # [m] clearance margin to walls and floor
POINT_MARGIN = 0.0005  # [m] clearance margin to the cloud
VOXEL = 0.0025  # [m] spacing to which the cloud is thinned
OVER = 0.003  # [m] smallest height of a point over the surface that counts as lying on it
COVER_SAMPLES = 200
OWN = 0.003  # [m] cloud points this close to the estimated workpiece belong to it

CORNERS = np.stack(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0], indexing="ij"), -1).reshape(-1, 3)
"""Corners (8, 3) of the box from -1 to 1."""
EDGES = np.argwhere(np.triu(np.abs(CORNERS[:, None] - CORNERS[None]).sum(-1) == 2))
"""Pairs (12, 2) of corners that are joined by an edge."""


def thin(points: Array, voxel: float = VOXEL) -> Array:
    """One point of every occupied voxel; deterministic."""
    if len(points) == 0:
        return points
    cells = np.floor(points / voxel).astype(np.int64)
    cells -= cells.min(axis=0)
    size = cells.max(axis=0) + 1
    _, first = np.unique((cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2], return_index=True)
    return points[np.sort(first)]


def without_workpiece(points: Array, T_world_part: Array, workpiece: Workpiece, margin: float = OWN) -> Array:
    """The points (n, 3) that do not lie on the workpiece at its estimated pose."""
    boxes = workpiece.piece_boxes()
    local = apply(invert(T_world_part), points)
    corners = np.concatenate([apply(T_part_box, CORNERS * size / 2) for size, T_part_box in boxes])
    low, high = corners.min(axis=0) - 2 * margin, corners.max(axis=0) + 2 * margin
    near = np.flatnonzero(((local > low) & (local < high)).all(axis=1))
    own = np.zeros(len(near), dtype=bool)
    for size, T_part_box in boxes:
        p = apply(invert(T_part_box), local[near])
        own |= (np.abs(p) < np.asarray(size) / 2 + margin).all(axis=1)
    return np.delete(points, near[own], axis=0)


def covered_share(workpiece: Workpiece, T_world_part: Array, others: Array, cell: float = 0.004) -> float:
    """Share in [0, 1] of the workpiece's surface that is covered by other measured points: these would be lifted too.

    Args:
        others: (n, 3) measured points in the world near the workpiece, without those of the workpiece.
        cell: [m] of the grid in which heights are compared.
    """
    if len(others) == 0:
        return 0.0
    surface = apply(T_world_part, workpiece.sample_surface(COVER_SAMPLES, seed=3)[0])
    low = np.minimum(surface[:, :2].min(axis=0), others[:, :2].min(axis=0))
    where, mine = (np.floor((p[:, :2] - low) / cell).astype(int) for p in (others, surface))
    top = np.full(np.maximum(where.max(axis=0), mine.max(axis=0)) + 1, -np.inf)
    np.maximum.at(top, (where[:, 0], where[:, 1]), others[:, 2])
    return float((top[mine[:, 0], mine[:, 1]] > surface[:, 2] + OVER).mean())


@dataclass(frozen=True)
class OpenGripper:
    """The gripper at one opening, in the tool frame: its boxes are parallel to that frame.

    Attributes:
        centres, halves: (b, 3) of its boxes in [m].
        corners: (8b, 3) of all boxes; edges: (12b, 2) the pairs of them that an edge joins.
    """

    centres: Array
    halves: Array
    corners: Array
    edges: np.ndarray

    @staticmethod
    def of(boxes: Sequence[Box]) -> OpenGripper:
        """From the gripper's boxes in the tool frame."""
        centres = np.stack([b.T_world_box[:3, 3] for b in boxes])
        halves = np.stack([np.asarray(b.size) / 2 for b in boxes])
        corners = (centres[:, None] + CORNERS[None] * halves[:, None]).reshape(-1, 3)
        edges = (8 * np.arange(len(boxes))[:, None, None] + EDGES).reshape(-1, 2)
        return OpenGripper(centres, halves, corners, edges)

    def hits_points(self, Ts_world_tool: Array, points: Array, margin: float = POINT_MARGIN) -> np.ndarray:
        """(n,) bool: a point (k, 3) in the world is inside the gripper at a tool pose (n, 4, 4)."""
        low, high = self.corners.min(axis=0) - margin, self.corners.max(axis=0) + margin
        shape = (self.centres, self.halves + margin, low, high)
        return np.asarray(_any_inside(invert(Ts_world_tool), np.ascontiguousarray(points), *shape))

    def room(self, T_world_tool: Array, points: Array, most: float) -> float:
        """Distance in [m] from the gripper at one tool pose (4, 4) to the nearest point (k, 3), at most `most`."""
        return float(_nearest(invert(T_world_tool), np.ascontiguousarray(points), self.centres, self.halves, most))

    def count(self, T_world_tool: Array, points: Array) -> int:
        """How many of the points (k, 3) are inside at one tool pose (4, 4)."""
        return int(_inside(invert(T_world_tool), np.ascontiguousarray(points), self.centres, self.halves))

    def hits_bin(self, Ts_world_tool: Array, bin: Bin) -> np.ndarray:
        """(n,) bool: a part of the gripper is in a wall, under the floor, or outside the walls below the rim."""
        lx, ly, lz = bin.inner
        p = apply(invert(bin.T_world_bin) @ Ts_world_tool, self.corners)
        hit = np.asarray((p[..., 2] < WALL_MARGIN).any(axis=1))
        below = lz + WALL_MARGIN - p[..., 2]
        for axis, half in ((0, lx / 2), (1, ly / 2)):
            for side in (-1, 1):
                beyond = side * p[..., axis] - half + WALL_MARGIN
                unsure = np.flatnonzero(~hit & (beyond > 0).any(axis=1))
                hit[unsure] = _both_positive(beyond[unsure], below[unsure], self.edges)
        return hit


def _both_positive(a: Array, b: Array, edges: np.ndarray) -> np.ndarray:
    """(n,) bool: two linear functions with values (n, k) at the corners are both above 0 at some point of an edge.

    That point is a corner, or near a crossing of a = 0 with b above 0 (a is above 0 next to it).
    """
    start, end = edges.T
    a0, a1, b0, b1 = a[:, start], a[:, end], b[:, start], b[:, end]
    crossing = (a0 > 0) != (a1 > 0)
    positive = (a0 * b1 - a1 * b0) * (a0 - a1) > 0  # b at the crossing, times (a0 - a1) squared
    return np.asarray(((a > 0) & (b > 0)).any(axis=1) | (crossing & positive).any(axis=1))


@numba.njit(cache=True)
def _nearest(T_tool_world, points, centres, halves, most):  # type: ignore[no-untyped-def]
    """Distance from boxes (b, 3) of a tool frame to the nearest of the points (k, 3) in the world, at most `most`."""
    least = most * most
    for p in points:
        local = moved(T_tool_world, p)
        for b in range(len(centres)):
            d = 0.0
            for m in range(3):
                d += max(abs(local[m] - centres[b, m]) - halves[b, m], 0.0) ** 2
            least = min(least, d)
    return math.sqrt(least)


@numba.njit(cache=True)
def _inside(T_tool_world, points, centres, halves):  # type: ignore[no-untyped-def]
    """How many of the points (k, 3) in the world are in one of the boxes (b, 3) of a tool frame."""
    count = 0
    for p in points:
        local = moved(T_tool_world, p)
        for b in range(len(centres)):
            x, y, z = local[0] - centres[b, 0], local[1] - centres[b, 1], local[2] - centres[b, 2]
            if abs(x) < halves[b, 0] and abs(y) < halves[b, 1] and abs(z) < halves[b, 2]:
                count += 1
                break
    return count


@numba.njit(cache=True)
def _any_inside(Ts_tool_world, points, centres, halves, low, high):  # type: ignore[no-untyped-def]
    """(n,) bool: one of the points (k, 3) in the world is in one of the boxes (b, 3) of a tool frame."""
    hit = np.zeros(len(Ts_tool_world), np.bool_)
    for i in range(len(Ts_tool_world)):
        for p in points:
            local = moved(Ts_tool_world[i], p)
            if not (low[0] < local[0] < high[0] and low[1] < local[1] < high[1] and low[2] < local[2] < high[2]):
                continue
            for b in range(len(centres)):
                x, y, z = local[0] - centres[b, 0], local[1] - centres[b, 1], local[2] - centres[b, 2]
                if abs(x) < halves[b, 0] and abs(y) < halves[b, 1] and abs(z) < halves[b, 2]:
                    hit[i] = True
                    break
            if hit[i]:
                break
    return hit
