"""Depth frame -> scene cloud in the normalised workpiece space (PS6D, sec. III-D).

The paper scales every workpiece to one cube and moves the scene to the origin, so that a single set of network
parameters serves all sizes; here 1 unit is `Workpiece.unit`, the longest side of all but slender workpieces. Points of
the empty bin are removed first: its position is calibrated in any cell, so this is known, not learned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickproof.cell.frames import Array, invert
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.sensing.camera import DepthFrame, Intrinsics

FLOOR_MARGIN = 0.002  # [m] points this close to floor or wall are taken for the bin


@dataclass(frozen=True)
class Cloud:
    """A scene cloud.

    Attributes:
        points: (n, 3) in units, camera axes, moved so that their mean is at the origin.
        view: (n, 3) unit vectors from each point to the camera.
        pixels: (n, 2) int, (v, u) of each point.
        origin: (3,) in [m]: camera coordinates of the cloud's origin.
        unit: length of one unit in [m].
    """

    points: Array
    view: Array
    pixels: np.ndarray
    origin: Array
    unit: float

    def to_camera(self, points: Array) -> Array:
        """Points (n, 3) of this cloud's space in camera coordinates [m]."""
        return points * self.unit + self.origin


def roi_mask(frame: DepthFrame, bin: Bin, margin: float = FLOOR_MARGIN) -> np.ndarray:
    """(h, w) bool: measured points inside the bin that are not the bin itself.

    Args:
        margin: [m] to keep from floor and walls.
    """
    T = invert(bin.T_world_bin) @ frame.T_world_camera
    right, down = ray_slopes(frame.intrinsics)
    x, y, z = (frame.depth * (T[i, 0] * right + (T[i, 1] * down + T[i, 2])) + T[i, 3] for i in range(3))
    lx, ly, lz = bin.inner
    x, y = np.abs(x), np.abs(y)
    inside = (x < lx / 2 - margin) & (y < ly / 2 - margin)
    over_rim = z > lz + margin  # parts may lean over the rim
    inside |= over_rim & (x < lx / 2 + 0.03) & (y < ly / 2 + 0.03)
    return np.asarray(inside & (z > margin) & (frame.depth > 0))


def ray_slopes(K: Intrinsics) -> tuple[Array, Array]:
    """x of each column (1, w) and y of each row (h, 1) of the rays with z = 1."""
    u, v = np.arange(K.width, dtype=np.float64)[None, :], np.arange(K.height, dtype=np.float64)[:, None]
    return (u - K.cx) / K.fx, (v - K.cy) / K.fy


def scene_cloud(frame: DepthFrame, mask: np.ndarray, unit: float) -> Cloud:
    """The cloud of the masked pixels; may be empty."""
    v, u = np.nonzero(mask & (frame.depth > 0))
    right, down = ray_slopes(frame.intrinsics)
    rays = np.stack([right[0, u], down[v, 0], np.ones(len(u))], axis=1)
    points = rays * frame.depth[v, u, None].astype(np.float64)
    origin = points.mean(axis=0) if len(points) else np.zeros(3)
    view = rays / -np.sqrt((rays * rays).sum(1, keepdims=True))
    return Cloud((points - origin) / unit, view, np.stack([v, u], axis=1), origin, unit)
