"""Outlines of the CAD from many views: where a part's surface ends in the image."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from torch import Tensor

from pickproof.cell.frames import Array

RIM_POINTS = 48
PIXEL = 1.0 / 128
"""Of the raster in which outlines are found, in units; each outline point is off by less than half of it."""


def outlines(samples: Array, views: Array) -> tuple[Tensor, Tensor]:
    """Points (w, q, 3) along the outline and outward directions (w, q, 3) for views (w, 3), parallel projection.

    Args:
        samples: (n, 3) dense surface samples in units.
    """
    found = [_outline(samples, view) for view in views]
    stack = [torch.from_numpy(np.stack(x).astype(np.float32)) for x in zip(*found, strict=True)]
    return stack[0], stack[1]


def _outline(samples: Array, view: Array) -> tuple[Array, Array]:
    helper = np.eye(3)[np.abs(view).argmin()]
    right = np.cross(helper, view)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(view, right)])
    flat = axes @ samples.T
    low = flat.min(1) - 6 * PIXEL
    size = np.ceil((flat.max(1) + 6 * PIXEL - low) / PIXEL).astype(int) + 1
    column, row = np.rint((flat - low[:, None]) / PIXEL).astype(int)
    depth = (samples @ view).astype(np.float32)
    height = np.full((size[1], size[0]), -np.inf, np.float32)
    order = np.argsort(depth)
    height[row[order], column[order]] = depth[order]  # of samples in one pixel the last, nearest one stays
    # samples leave pinholes: close them, then find outline and holes
    kernel = np.ones((5, 5), np.uint8)
    mask = cv2.morphologyEx((height > -np.inf).astype(np.uint8), cv2.MORPH_CLOSE, kernel)
    front = cv2.dilate(height, kernel)
    smooth = cv2.GaussianBlur(mask.astype(np.float32), (9, 9), 2.0)
    contours, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    path = np.concatenate([c[:, 0] for c in contours if len(c) >= 12])
    path = path[np.linspace(0, len(path) - 1, RIM_POINTS).round().astype(int)]
    x, y = path[:, 0], path[:, 1]
    slope = np.stack([smooth[y, x - 1] - smooth[y, x + 1], smooth[y - 1, x] - smooth[y + 1, x]], -1).astype(np.float64)
    slope /= np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-9)
    position = path * PIXEL + low
    points = position @ axes + front[y, x, None] * view
    return points, slope @ axes
