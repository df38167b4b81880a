"""What the measured depth tells grasping and planning about the source bin."""

from __future__ import annotations

import numpy as np

from cell.camera import DepthFrame
from cell.frames import Array, apply, invert
from robots.collision import HeightField
from scenarios.workcell import SOURCE, Workcell

BIN_MARGIN = 0.002  # [m] from floor and walls within which a measured point is the bin's
GRID = 0.004  # [m] of the height field
TRUE_SAMPLES = 1500  # of each workpiece's surface
LONE = 0.008  # [m] of depth within which a neighbouring pixel supports a measurement
SUPPORT = 2  # of eight neighbours that a measurement needs: at edges single pixels fly between near and far


def scene_points(cell: Workcell, frame: DepthFrame) -> Array:
    """Measured points (n, 3) in the world over the source bin that are neither the bin nor flying pixels."""
    points = frame.points_world()[supported(frame.depth)[frame.depth > 0]]
    local = apply(invert(cell.source.T_world_bin), points)
    lx, ly, _ = cell.source.inner
    inside = (np.abs(local[:, 0]) < lx / 2 - BIN_MARGIN) & (np.abs(local[:, 1]) < ly / 2 - BIN_MARGIN)
    return points[inside & (local[:, 2] > BIN_MARGIN)]


def true_points(cell: Workcell) -> Array:
    """Points (n, 3) in the world on all sides of the workpieces in the source bin, from ground truth."""
    truth = cell.observe()
    surface = cell.workpiece.sample_surface(TRUE_SAMPLES, seed=4)[0]
    return apply(truth.Ts_world_part[list(truth.parts_in(SOURCE))], surface).reshape(-1, 3)


def supported(depth: np.ndarray) -> np.ndarray:
    """(h, w) bool: pixels with at least SUPPORT of their eight neighbours within LONE of their own depth [m]."""
    h, w = depth.shape
    padded = np.pad(depth, 1, constant_values=-1.0)
    count = np.zeros((h, w), dtype=np.int8)
    for dv, du in ((0, 0), (0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1), (2, 2)):
        count += np.abs(padded[dv : dv + h, du : du + w] - depth) < LONE
    return (count >= SUPPORT) & (depth > 0)


def scan_heights(cell: Workcell, frame: DepthFrame) -> HeightField:
    """Highest measured point of every cell of a grid over the source bin; its floor where nothing was measured."""
    points, T_world_bin = scene_points(cell, frame), cell.source.T_world_bin
    lx, ly, _ = cell.source.inner
    half = np.abs(T_world_bin[:2, :2]) @ (lx / 2, ly / 2)  # the grid is along the world's axes, the bin may be turned
    low = T_world_bin[:2, 3] - half
    nx, ny = (2 * half / GRID).astype(int) + 1
    heights = np.full((ny, nx), T_world_bin[2, 3] - GRID)
    column, row = np.clip(np.rint((points[:, :2] - low) / GRID).astype(int), 0, (nx - 1, ny - 1)).T
    np.maximum.at(heights, (row, column), points[:, 2])
    return HeightField(heights, float(low[0]), float(low[1]), GRID)
