"""A point cloud as a depth image, since perception also needs the free space between camera and surface.

A cloud computed from a camera image lies on that image's rays: its pixel grid is recovered without loss. Any other
cloud is projected by a pinhole camera at the camera's position, with pixels as wide as the point spacing.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from pickproof.cell.frames import Array
from pickproof.cell.sensing.camera import DepthFrame, Intrinsics
from pickproof.perception.data.noise_estimate import measured_sigma

COHERENT = 0.9
"""Mean resultant length from which the slopes of the rays lie on a grid; 1 for an exact one, 0.02 for chance."""
EMPTY = 0.1
"""Most empty pixels inside the surface of an image of a cloud without a grid."""
MOST_PIXELS = 4_000_000
SAMPLE = 3000


@dataclass(frozen=True)
class Grid:
    """Pixel coordinate of a slope x/z or y/z: focal * slope + centre."""

    focal: float
    centre: float


def depth_image(points_camera: Array, T_world_camera: Array) -> DepthFrame:
    """The depth image of points (n, 3) [m] in camera axes, all before the camera at the origin, z forward."""
    z = points_camera[:, 2]
    slopes = points_camera[:, :2] / z[:, None]
    few = slopes[np.random.default_rng(0).choice(len(slopes), min(SAMPLE, len(slopes)), replace=False)]
    apart = cKDTree(slopes).query(few, k=2)[0][:, 1] if len(slopes) > 1 else np.ones(1)
    apart = apart[apart > 1e-9]
    dense = 1 / float(np.median(apart)) if len(apart) else 1000.0
    span = np.maximum(np.ptp(slopes, axis=0), 1e-3)
    dense = min(dense, float(np.sqrt(MOST_PIXELS / span.prod())))
    grids = [find_grid(few[:, axis], dense) for axis in (0, 1)]
    found = [grid for grid in grids if grid is not None]
    if len(found) == 2:
        depth, K = _image(slopes, z, (found[0], found[1]))
    else:
        depth, K = _resampled(slopes, z, dense)
    return DepthFrame(depth, K, T_world_camera, measured_sigma(depth))


def find_grid(slopes: Array, about: float) -> Grid | None:
    """The grid on which slopes (n,) lie, with a focal length of 0.6 to 1.3 times `about` [pixel]; None without one.

    On a grid of focal length f all f * slope have the same fraction, so |mean exp(2 pi i f slope)| is 1; the lowest
    such f is the grid's, its multiples have the property too.
    """
    step = 0.2 / max(float(np.ptp(slopes)), 1e-6)
    focals = np.arange(0.6 * about, 1.3 * about, step)
    if len(focals) > 20_000 or len(slopes) < 100:
        return None
    strength = np.array([abs(np.exp(2j * np.pi * f * slopes).mean()) for f in focals])
    good = np.flatnonzero(strength > COHERENT - 0.1)
    if not len(good):
        return None
    first = good[good <= good[0] + 5]  # of one peak
    f = focals[first[strength[first].argmax()]]
    for _ in range(12):
        near = f + step * np.linspace(-1, 1, 11)
        f = near[np.argmax([abs(np.exp(2j * np.pi * x * slopes).mean()) for x in near])]
        step /= 3
    mean = np.exp(2j * np.pi * f * slopes).mean()
    return Grid(float(f), float(-np.angle(mean) / (2 * np.pi))) if abs(mean) > COHERENT else None


def _resampled(slopes: Array, z: Array, dense: float) -> tuple[np.ndarray, Intrinsics]:
    """As dense an image as the cloud fills."""
    focal = dense
    while True:
        depth, K = _image(slopes, z, (Grid(focal, 0.0), Grid(focal, 0.0)))
        filled = (depth > 0).astype(np.uint8)
        closed = cv2.morphologyEx(filled, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
        if 1 - filled.sum() / closed.sum() <= EMPTY or focal < 0.1 * dense:
            return depth, K
        focal *= 0.9


def _image(slopes: Array, z: Array, grids: tuple[Grid, Grid]) -> tuple[np.ndarray, Intrinsics]:
    """Each pixel takes the point nearest its centre, of those near the foremost one."""
    uv = np.stack([grid.focal * slopes[:, axis] + grid.centre for axis, grid in enumerate(grids)], axis=1)
    low = np.floor(uv.min(0)) - 2
    width, height = (np.ceil(uv.max(0)) - low + 3).astype(int)
    uv -= low
    pixel = np.rint(uv).astype(np.int64)
    off = np.square(uv - pixel).sum(1)
    flat = pixel[:, 1] * width + pixel[:, 0]
    foremost = np.full(width * height, np.inf)
    np.minimum.at(foremost, flat, z)
    front = np.flatnonzero(z < foremost[flat] * (1 + 4 / grids[0].focal))  # four pixels' width behind it
    order = front[np.lexsort((off[front], flat[front]))]
    pixels, first = np.unique(flat[order], return_index=True)
    depth = np.zeros(width * height, np.float32)
    depth[pixels] = z[order[first]]
    (fx, fy), (cx, cy) = (g.focal for g in grids), (g.centre - x for g, x in zip(grids, low, strict=True))
    return depth.reshape(height, width), Intrinsics(int(width), int(height), fx, fy, float(cx), float(cy))
