"""Room for the open gripper: against the bin exactly, against the rest of the heap by the scene cloud."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from cell.bin import Bin, Box
from cell.frames import Array, apply, invert
from cell.workpiece import Workpiece

WALL_MARGIN = 0.0008  # [m] kept from walls and floor
POINT_MARGIN = 0.0005  # [m] kept from the cloud
VOXEL = 0.0025  # [m] spacing to which the cloud is thinned
OWN = 0.003  # [m] cloud points this close to the estimated workpiece are its own


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
    for box in workpiece.collision_boxes:
        p = apply(invert(box.T_part_box), local)
        own |= (np.abs(p) < np.asarray(box.size) / 2 + margin).all(axis=1)
    return points[~own]


def points_in_gripper(Ts_world_tool: Array, boxes: Sequence[Sequence[Box]], points: Array) -> np.ndarray:
    """Number of cloud points (n,) inside the gripper's boxes at each tool pose.

    Args:
        Ts_world_tool: (n, 4, 4).
        boxes: for each pose its boxes in the tool frame.
        points: (k, 3) in the world, without those of the workpiece itself.
    """
    count = np.zeros(len(Ts_world_tool), dtype=np.intp)
    if len(points) == 0:
        return count
    reach = max((float(np.linalg.norm(np.asarray(b.size) / 2) + np.linalg.norm(b.T_world_box[:3, 3])))
                for bs in boxes[:1] for b in bs)  # fmt: skip
    tree = cKDTree(points)
    for i, (T, mine) in enumerate(zip(Ts_world_tool, boxes, strict=True)):
        near = points[tree.query_ball_point(T[:3, 3], reach + 0.02)]
        if len(near) == 0:
            continue
        p = apply(invert(T), near)
        inside = np.zeros(len(near), dtype=bool)
        for box in mine:
            q = p - box.T_world_box[:3, 3]  # the gripper's boxes are parallel to the tool frame
            inside |= (np.abs(q) < np.asarray(box.size) / 2 + POINT_MARGIN).all(axis=1)
        count[i] = int(inside.sum())
    return count


def corners(box: Box) -> Array:
    """Corners and edge midpoints (20, 3) of a box in the frame in which it is given."""
    grid = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1], indexing="ij"), -1).reshape(-1, 3)
    surface = grid[np.abs(grid).sum(1) >= 2]
    return apply(box.T_world_box, surface * np.asarray(box.size) / 2)


def hits_bin(Ts_world_tool: Array, boxes: Sequence[Sequence[Box]], bin: Bin) -> np.ndarray:
    """(n,) bool: a corner or an edge's middle of the gripper is inside a wall, under the floor or outside below the rim."""
    lx, ly, lz = bin.inner
    T_bin_world = invert(bin.T_world_bin)
    local = np.stack([np.concatenate([corners(b) for b in mine]) for mine in boxes])
    p = apply(T_bin_world @ Ts_world_tool, local)
    low = p[..., 2] < lz + WALL_MARGIN
    beyond = (np.abs(p[..., 0]) > lx / 2 - WALL_MARGIN) | (np.abs(p[..., 1]) > ly / 2 - WALL_MARGIN)
    return ((low & beyond) | (p[..., 2] < WALL_MARGIN)).any(axis=1)
