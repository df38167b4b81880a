"""Points and height map of the source bin from the measured depth, for grasping and planning."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np

from pickproof.cell.frames import Array, apply, invert
from pickproof.cell.physics.observation import Snapshot
from pickproof.cell.point import moved
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.clearance import without_workpiece
from pickproof.robots.collision.scene import HeightField
from pickproof.scenarios.picking.cell_model import SOURCE, CellModel

BIN_MARGIN = 0.002  # [m] from floor and walls within which a measured point belongs to the bin
GRID = 0.004  # [m] of the height field
TRUE_SAMPLES = 1500  # of each workpiece's surface
LONE = 0.008  # [m] of depth within which a neighbouring pixel supports a measurement
UNDERSIDE_SAMPLES = 3000  # of a workpiece's surface
SUPPORT = 2  # of eight neighbours that a measurement needs: at edges single pixels lie between near and far


def scene_points(cell: CellModel, frame: DepthFrame) -> Array:
    """Measured points (n, 3) in the world over the source bin that are neither the bin nor flying pixels."""
    k, (lx, ly, _) = frame.intrinsics, cell.source.inner
    pinhole = np.array([k.fx, k.fy, k.cx, k.cy])
    room = np.array([lx / 2 - BIN_MARGIN, ly / 2 - BIN_MARGIN, BIN_MARGIN])
    T_bin_world = invert(cell.source.T_world_bin)
    return np.asarray(_points_inside(frame.depth, pinhole, frame.T_world_camera, T_bin_world, room))


def true_points(cell: CellModel, truth: Snapshot) -> Array:
    """Points (n, 3) in the world on all sides of the workpieces in the source bin, from ground truth."""
    surface = cell.workpiece.sample_surface(TRUE_SAMPLES, seed=4)[0]
    return apply(truth.Ts_world_part[list(truth.parts_in(SOURCE))], surface).reshape(-1, 3)


@numba.njit(cache=True)
def _points_inside(depth, pinhole, T_world_camera, T_bin_world, room):  # type: ignore[no-untyped-def]
    """Points (n, 3) in the world of all pixels with SUPPORT of their neighbours whose point is in a box of the bin."""
    h, w = depth.shape
    points, n = np.empty((h * w, 3)), 0
    for v in range(h):
        for u in range(w):
            z = depth[v, u]
            if not z > 0.0:
                continue
            world = moved(T_world_camera, ((u - pinhole[2]) / pinhole[0] * z, (v - pinhole[3]) / pinhole[1] * z, z))
            x, y, over = moved(T_bin_world, world)
            if abs(x) < room[0] and abs(y) < room[1] and over > room[2] and supported(depth, v, u):
                points[n, 0], points[n, 1], points[n, 2] = world
                n += 1
    return points[:n].copy()


@numba.njit(cache=True)
def supported(depth, v, u):  # type: ignore[no-untyped-def]
    """Whether a pixel has at least SUPPORT of its eight neighbours within LONE of its own depth [m]."""
    h, w = depth.shape
    count = 0
    for i in range(max(v - 1, 0), min(v + 2, h)):
        for j in range(max(u - 1, 0), min(u + 2, w)):
            count += (i != v or j != u) and abs(depth[i, j] - depth[v, u]) < LONE
    return count >= SUPPORT


@dataclass(frozen=True, eq=False)
class Scan:
    """The heap in the source bin as measured in one image.

    Attributes:
        points: (n, 3), see `scene_points`. floor: z under unseen cells in [m].
        field: highest measured point of every cell of a grid over the bin, `floor` where nothing was measured.
    """

    points: Array
    floor: float
    field: HeightField

    @staticmethod
    def of(cell: CellModel, frame: DepthFrame) -> Scan:
        """Of the source bin in a frame."""
        points, T_world_bin = scene_points(cell, frame), cell.source.T_world_bin
        lx, ly, _ = cell.source.inner
        half = np.abs(T_world_bin[:2, :2]) @ (
            lx / 2,
            ly / 2,
        )  # along the world's axes
        low = T_world_bin[:2, 3] - half
        nx, ny = (2 * half / GRID).astype(int) + 1
        floor = float(T_world_bin[2, 3] - GRID)
        heights = np.full((ny, nx), floor)
        raise_to(heights, points, low, GRID)
        return Scan(points, floor, HeightField(heights, float(low[0]), float(low[1]), GRID))

    def without(self, T_world_part: Array, workpiece: Workpiece) -> HeightField:
        """The heap without the workpiece at an estimated pose.

        Where only this workpiece was measured, the heap is not higher than its underside.
        """
        field, low = self.field, np.array([self.field.x0, self.field.y0])
        rest = np.full_like(field.heights, self.floor)
        reach = float(np.linalg.norm(workpiece.extents))  # its origin is within its bounding box
        near = (np.abs(self.points - T_world_part[:3, 3]) < reach).all(axis=1)
        raise_to(rest, self.points[~near], low, GRID)
        raise_to(rest, without_workpiece(self.points[near], T_world_part, workpiece), low, GRID)
        surface = apply(T_world_part, workpiece.sample_surface(UNDERSIDE_SAMPLES, seed=5)[0])
        under = np.full_like(field.heights, np.inf)
        _lower(under, surface, low)
        under[np.isinf(under)] = self.floor
        return replace(field, heights=np.minimum(np.maximum(rest, under), field.heights))


@numba.njit(cache=True)
def raise_to(heights, points, low, step):  # type: ignore[no-untyped-def]
    """Raise cells (ny, nx) of a grid of `step` [m] that begins at `low` (2,) to the points (n, 3) in them."""
    ny, nx = heights.shape
    for p in points:
        column = min(max(int(np.rint((p[0] - low[0]) / step)), 0), nx - 1)
        row = min(max(int(np.rint((p[1] - low[1]) / step)), 0), ny - 1)
        heights[row, column] = max(heights[row, column], p[2])


@numba.njit(cache=True)
def _lower(heights, points, low):  # type: ignore[no-untyped-def]
    """Lower cells (ny, nx) and those beside them to the points (n, 3)."""
    ny, nx = heights.shape
    for p in points:
        column, row = int(np.rint((p[0] - low[0]) / GRID)), int(np.rint((p[1] - low[1]) / GRID))
        for i in range(max(row - 1, 0), min(row + 2, ny)):
            for j in range(max(column - 1, 0), min(column + 2, nx)):
                heights[i, j] = min(heights[i, j], p[2])
