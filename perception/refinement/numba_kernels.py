"""What the loops over points share, compiled by numba into them.

In tensors each point's row of a table, residual and Jacobian would be written out to memory and read again a dozen
times. Poses R (h, 3, 3), t (h, 3) carry CAD to camera coordinates; lengths in units; all in float32.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np


class KernelPoses(NamedTuple):
    """h poses: R (h, 3, 3), t (h, 3), and the index (h,) of the view that each shows the camera."""

    R: np.ndarray
    t: np.ndarray
    view: np.ndarray


@numba.njit(cache=True)
def turned(R, i, x, y, z):  # type: ignore[no-untyped-def]
    """R_i p."""
    return (
        R[i, 0, 0] * x + R[i, 0, 1] * y + R[i, 0, 2] * z,
        R[i, 1, 0] * x + R[i, 1, 1] * y + R[i, 1, 2] * z,
        R[i, 2, 0] * x + R[i, 2, 1] * y + R[i, 2, 2] * z,
    )


@numba.njit(cache=True)
def turned_back(R, i, x, y, z):  # type: ignore[no-untyped-def]
    """R_i^T p."""
    return (
        R[i, 0, 0] * x + R[i, 1, 0] * y + R[i, 2, 0] * z,
        R[i, 0, 1] * x + R[i, 1, 1] * y + R[i, 2, 1] * z,
        R[i, 0, 2] * x + R[i, 1, 2] * y + R[i, 2, 2] * z,
    )


@numba.njit(cache=True)
def pixel_of(camera, x, y, z):  # type: ignore[no-untyped-def]
    """Flat index of the pixel that sees a camera point, -1 outside the image; `camera` as in `SurfaceMap`."""
    z = max(z, np.float32(1e-3))
    u, v = np.rint(x / z * camera[0] + camera[2]), np.rint(y / z * camera[1] + camera[3])
    if u < 0 or u > camera[4] - 1 or v < 0 or v > camera[5] - 1:
        return -1
    return int(v) * int(camera[4]) + int(u)


@numba.njit(cache=True)
def distance_at(field, origin, step, shape, x, y, z):  # type: ignore[no-untyped-def]
    """Signed distance and gradient x, y, z at a CAD point, as `DistanceField.look_up`."""
    inverse = np.float32(1.0) / step
    a = min(max(np.rint((x - origin[0]) * inverse), 0), shape[0] - 1)
    b = min(max(np.rint((y - origin[1]) * inverse), 0), shape[1] - 1)
    c = min(max(np.rint((z - origin[2]) * inverse), 0), shape[2] - 1)
    node = (int(a) * shape[1] + int(b)) * shape[2] + int(c)
    gx, gy, gz = field[node, 1], field[node, 2], field[node, 3]
    return field[node, 0] + gx * x + gy * y + gz * z, gx, gy, gz
