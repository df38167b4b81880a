"""Depth given as ray length (range) instead of z: detected by bent flat surfaces, and converted."""

from __future__ import annotations

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.sensing.camera import Intrinsics
from pickproof.perception.data.region import find_plane

SAMPLE = 4000
LEAST_POINTS = 500
MORE = 1.5
"""How many times as many points must lie on one plane after conversion as before."""
SHARE = 0.15
"""Least share of the points on that plane: a flat surface, not chance."""
BETTER = 3.0
"""How many times as far the points of that plane must scatter about their best plane without the conversion."""
LEAST_BEND = 6.0
"""Least change of a surface across the image by the conversion, in standard deviations of the noise."""


def to_z(depth: Array, K: Intrinsics) -> Array:
    """z (h, w) of lengths of rays (h, w); 0 stays 0."""
    return np.asarray(depth / np.linalg.norm(K.rays(), axis=-1))


def bends_flat_surfaces(values: np.ndarray, K: Intrinsics, sigma: float, given: str = "z") -> bool:
    """Whether the largest flat surface of a scene is flat only if values are not what they are given as.

    Args:
        values: (h, w) [m], 0 where missing; sigma: [m] noise of them.
        given: z or range; the other one is what they may be.
    """
    pixels = np.argwhere(values > 0)
    if len(pixels) < LEAST_POINTS:
        return False
    rng = np.random.default_rng(0)  # the same image gives the same answer
    v, u = pixels[rng.choice(len(pixels), min(SAMPLE, len(pixels)), replace=False)].T
    rays = np.column_stack([(u - K.cx) / K.fx, (v - K.cy) / K.fy, np.ones(len(u))])
    length = np.linalg.norm(rays, axis=1)
    as_z = rays * values[v, u, None].astype(np.float64)
    as_range = as_z / length[:, None]
    bend = float(np.median(values[v, u])) * float(np.ptp(1 / length))
    if bend < LEAST_BEND * sigma:
        return False
    margin = max(2.5 * sigma, bend / 40)
    as_given, as_other = (as_z, as_range) if given == "z" else (as_range, as_z)
    before, after = (_on_plane(points, margin, rng) for points in (as_given, as_other))
    if after.mean() < SHARE or after.sum() < MORE * before.sum():
        return False
    return _scatter(as_given[after]) > BETTER * _scatter(as_other[after])


def _on_plane(points: Array, margin: float, rng: np.random.Generator) -> np.ndarray:
    """Which points (n, 3) lie within `margin` [m] of the plane that has the most of them."""
    plane = find_plane(points, margin, rng, 1.0)
    if plane is None:
        return np.zeros(len(points), dtype=bool)
    return np.abs(points @ plane.normal + plane.offset) < margin


def _scatter(points: Array) -> float:
    """[m] root mean square distance of points (n, 3) from their own plane."""
    return float(np.sqrt(max(np.linalg.eigvalsh(np.cov(points.T))[0], 0.0)))
