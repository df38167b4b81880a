"""What the measured depth tells grasping and planning about the source bin."""

from __future__ import annotations

import numpy as np

from cell.camera import DepthFrame
from cell.frames import Array, apply, invert
from robots.collision import HeightField
from scenarios.workcell import Workcell

BIN_MARGIN = 0.002  # [m] from floor and walls within which a measured point is the bin's
GRID = 0.004  # [m] of the height field


def scene_points(cell: Workcell, frame: DepthFrame) -> Array:
    """Measured points (n, 3) in the world that lie over the source bin and are not the bin."""
    points = frame.points_world()
    local = apply(invert(cell.source.T_world_bin), points)
    lx, ly, _ = cell.source.inner
    inside = (np.abs(local[:, 0]) < lx / 2 - BIN_MARGIN) & (np.abs(local[:, 1]) < ly / 2 - BIN_MARGIN)
    return points[inside & (local[:, 2] > BIN_MARGIN)]


def scan_heights(cell: Workcell, frame: DepthFrame) -> HeightField:
    """Highest measured point of every cell of a grid over the source bin; its floor where nothing was measured."""
    lx, ly, _ = cell.source.inner
    local = apply(invert(cell.source.T_world_bin), scene_points(cell, frame))
    nx, ny = int(lx / GRID) + 1, int(ly / GRID) + 1
    heights = np.full((ny, nx), -GRID)
    column = np.clip(np.rint((local[:, 0] + lx / 2) / GRID).astype(int), 0, nx - 1)
    row = np.clip(np.rint((local[:, 1] + ly / 2) / GRID).astype(int), 0, ny - 1)
    np.maximum.at(heights, (row, column), local[:, 2])
    x, y, z = cell.source.position
    return HeightField(heights + z, x - lx / 2, y - ly / 2, GRID)
