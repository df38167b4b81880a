"""Plausibility checks of camera matrices and poses; an error names the probable mistake."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array

MM = 1000.0
ASPECT = 2.0
"""Most of fx / fy, and of fy / fx: pixels are square, or binned 2 x 1."""
VIEW_DEG = (2.0, 150.0)
"""[deg] between which the full angle of view lies, along x and along y."""
CENTRED, IN_CROP = (0.4, 0.6), (0.05, 0.95)
"""Of the image's width and height, between which the principal point lies; the same where the image may be a crop."""
FARTHEST = 20.0
"""[m] of any length of a scene: where cameras, bins and boxes are."""
STEP = (5e-6, 1e-2)
"""[m] between which a count of a depth image lies."""
SIGMA = (1e-6, 0.01)
"""[m] between which the noise of a depth lies."""


def check_matrix(K: Array, source: str | Path) -> None:
    """Refuse what is no camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]].

    Raises:
        InputError: it is transposed, scaled or skewed, or its numbers are not finite or not above 0.
    """
    if not np.isfinite(K).all():
        raise InputError(source, "intrinsics", K.tolist(), "finite numbers, fx and fy above 0")
    small = 1e-6 * max(float(np.abs(K).max()), 1.0)
    below = np.abs([K[1, 0], K[2, 0], K[2, 1]])
    if below[1:].max() > small and np.abs(K[:2, 2]).max() <= small:
        valid = "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; this looks like column order: transpose it"
        raise InputError(source, "intrinsics", K.tolist(), valid)
    if abs(K[2, 2] - 1) > 1e-6 or below.max() > small:
        valid = "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]], row by row"
        raise InputError(source, "intrinsics", K.tolist(), valid)
    if abs(K[0, 1]) > small:
        raise InputError(source, "skew", float(K[0, 1]), "0: rows and columns of the image at right angles")
    fx, fy = float(K[0, 0]), float(K[1, 1])
    if min(fx, fy) <= 0:
        raise InputError(source, "fx, fy", [fx, fy], "above 0: x right, y down, z forward")
    if not 1 / ASPECT <= fx / fy <= ASPECT:
        raise InputError(source, "fx, fy", [fx, fy], f"alike, within a factor of {ASPECT:g}; are the numbers in order?")


def check_size(K: Array, width: int, height: int, stated: bool, source: str | Path) -> None:
    """Refuse a matrix that is not of an image of this size.

    Args:
        stated: the camera's file states this size, so the image may be a crop.

    Raises:
        InputError: the principal point or the angle of view cannot be those of this image.
    """
    size = np.array([width, height], dtype=np.float64)
    focal, centre = np.array([K[0, 0], K[1, 1]]), np.array([K[0, 2], K[1, 2]])
    at = (centre + 0.5) / size
    swapped = (centre[::-1] + 0.5) / size
    found = f"{centre[0]:.6g}, {centre[1]:.6g} in an image of {width} x {height}"
    off, off_swapped = np.abs(at - 0.5).max(), np.abs(swapped - 0.5).max()
    if off > 0.08 and off_swapped < 0.05 and off > 3 * off_swapped:
        raise InputError(source, "cx, cy", found, "cx along the width and cy along the height; they look swapped")
    low, high = IN_CROP if stated else CENTRED
    if not ((at >= low) & (at <= high)).all():
        valid = f"a principal point at {low:g} to {high:g} of width and height"
        if not stated:
            whole = (2 * centre + 1).round().astype(int)
            other = f"; is this the camera of an image of {whole[0]} x {whole[1]}?" if whole.min() > 1 else ""
            valid += other + " Of a crop, the camera's file states width and height"
        raise InputError(source, "cx, cy", found, valid)
    view = np.rad2deg(np.arctan(centre / focal) + np.arctan((size - 1 - centre) / focal))
    if not ((view >= VIEW_DEG[0]) & (view <= VIEW_DEG[1])).all():
        valid = f"{VIEW_DEG[0]:g} to {VIEW_DEG[1]:g}; are focal lengths and centre in pixels of this image?"
        raise InputError(source, "angle of view in deg", [round(float(x), 2) for x in view], valid)


def check_step(step: float, source: str | Path, field: str, unit: float = MM) -> None:
    """Refuse a count of a depth image, `step` [m], that no camera has; `unit` counts of `field` make 1 m."""
    low, high = STEP
    if not (np.isfinite(step) and step > 0):
        raise InputError(source, field, step * unit, "a number above 0")
    if not low <= step <= high:
        name, other = ("mm", "m") if unit == MM else ("m", "mm")
        valid = f"{low * unit:g} to {high * unit:g} {name} a count; in {name}, is it in {other}?"
        raise InputError(source, field, round(step * unit, 12), valid)


def check_sigma(sigma: float, source: str | Path, field: str) -> None:
    """Refuse a standard deviation [m] of depth that no camera has."""
    if not (np.isfinite(sigma) and sigma > 0):
        raise InputError(source, field, sigma, "a number above 0")
    low, high = SIGMA
    if not low <= sigma <= high:
        raise InputError(source, field, sigma, f"{low:g} to {high:g} m; in m, is it in mm?")


def is_rigid(T: Array) -> bool:
    """Whether T (4, 4) is a rotation and a translation, as far as four digits tell."""
    R = T[:3, :3]
    whole = bool(np.isfinite(T).all()) and np.allclose(T[3], [0, 0, 0, 1])
    return whole and np.allclose(R @ R.T, np.eye(3), atol=1e-3) and float(np.linalg.det(R)) > 0


def check_pose(T: Array, source: str | Path, field: str) -> None:
    """Refuse what is no rigid transform (4, 4), or one whose translation cannot be in [m].

    Raises:
        InputError: it is neither.
    """
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise InputError(source, field, T.tolist(), "a 4 x 4 rigid transform of finite numbers, row by row")
    if np.abs(T[3, :3]).max() > 1e-6 and np.abs(T[:3, 3]).max() < 1e-9:
        valid = "a 4 x 4 rigid transform, row by row; this looks like column order: transpose it"
        raise InputError(source, field, T.tolist(), valid)
    if not is_rigid(T):
        raise InputError(source, field, T.tolist(), "a 4 x 4 rigid transform, row by row")
    if np.linalg.norm(T[:3, 3]) > FARTHEST:
        valid = f"a translation below {FARTHEST:g} m; in m, is it in mm?"
        raise InputError(source, field, T[:3, 3].tolist(), valid)


def check_mm(t: Array, source: str | Path, field: str, nearest: float, zero: bool = False) -> None:
    """Refuse a translation (3,) [mm] of a BOP file that cannot be in mm.

    Args:
        nearest: [mm] below which it is likely in m; `zero`: none at all passes, as of the camera that is the world.
    """
    length = float(np.linalg.norm(t))
    if not length <= MM * FARTHEST:  # catches NaN too
        raise InputError(source, field, t.tolist(), f"below {MM * FARTHEST:g} mm")
    if length < nearest and not (zero and length < 0.01):
        raise InputError(source, field, t.tolist(), f"over {nearest:g} mm; in mm, is it in m?")
