"""Depth frame -> scene cloud in the normalised workpiece space (PS6D, sec. III-D).

The paper scales every workpiece to one cube and moves the scene to the origin, so that a single set of network
parameters serves all sizes; here 1 unit is `Workpiece.unit`, the longest side of all but slender workpieces. Points of
the empty bin are removed first: its position is calibrated in any cell, so this is known, not learned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.bin import Bin
from cell.camera import DepthFrame
from cell.frames import Array, apply, invert

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
    points, pixels = frame.points_camera()
    T_bin_camera = invert(bin.T_world_bin) @ frame.T_world_camera
    p = apply(T_bin_camera, points)
    lx, ly, lz = bin.inner
    inside = (np.abs(p[:, 0]) < lx / 2 - margin) & (np.abs(p[:, 1]) < ly / 2 - margin)
    over_rim = p[:, 2] > lz + margin  # parts may lean over the rim
    inside |= over_rim & (np.abs(p[:, 0]) < lx / 2 + 0.03) & (np.abs(p[:, 1]) < ly / 2 + 0.03)
    inside &= p[:, 2] > margin
    mask = np.zeros(frame.depth.shape, dtype=bool)
    mask[pixels[inside, 0], pixels[inside, 1]] = True
    return mask


def scene_cloud(frame: DepthFrame, mask: np.ndarray, unit: float) -> Cloud:
    """The cloud of the masked pixels; may be empty."""
    pixels = np.argwhere(mask & (frame.depth > 0))
    rays = frame.intrinsics.rays()[pixels[:, 0], pixels[:, 1]]
    points = rays * frame.depth[pixels[:, 0], pixels[:, 1], None].astype(np.float64)
    origin = points.mean(axis=0) if len(points) else np.zeros(3)
    view = -rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return Cloud((points - origin) / unit, view, pixels, origin, unit)
