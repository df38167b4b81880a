"""Estimates the depth noise of an image from the image itself."""

from __future__ import annotations

import numpy as np

from pickproof.cell.sensing.camera import DEPTH_SIGMA

MOST = 0.005  # [m] beyond which rough surfaces, not noise, were measured


def measured_sigma(depth: np.ndarray, step: float = 0.0) -> float:
    """Standard deviation [m] of a depth image (h, w) in [m], 0 where missing; at least that of a good camera.

    The second difference along rows vanishes on planes, so its median over all pixels tells the noise of single pixels
    (by the normal distribution, as in Immerkaer 1996). `step` [m] is what a count of a stored image stands for:
    rounding to it has the standard deviation step / sqrt(12), which a smooth surface hides.
    """
    left, middle, right = depth[:, :-2], depth[:, 1:-1], depth[:, 2:]
    whole = (left > 0) & (middle > 0) & (right > 0)
    bend = np.abs(left.astype(np.float64) - 2 * middle + right)[whole]
    scatter = float(np.median(bend)) / (0.6745 * np.sqrt(6)) if len(bend) else 0.0
    return float(np.clip(max(scatter, step / np.sqrt(12)), DEPTH_SIGMA, MOST))
