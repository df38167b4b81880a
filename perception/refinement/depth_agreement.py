"""How well poses agree with a depth image, point by point; the common measure of scoring and verification."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import torch
from torch import Tensor

from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.numba_kernels import KernelPoses, distance_at, pixel_of, turned, turned_back


@dataclass(frozen=True)
class Agreement:
    """Visible CAD points of h poses against what was measured at their pixels; all (h, p).

    Attributes:
        distance: signed distance of the measured point to the CAD (positive outside), in units.
        facing: cosine between measured normal and CAD normal there; 0 where the normal is unknown.
        gap: nearest depth around the pixel minus depth of the CAD point: positive where the camera saw through the
            part; 0 where nothing was measured.
        in_front: depth of the CAD point minus measured depth: positive where something hides the part.
        measured: a surface was measured at the pixel; known_normal: and its normal.
        points: (h, p, 3) the measured points in the CAD frame; drawn: the CAD points in the camera frame.
    """

    distance: Tensor
    facing: Tensor
    gap: Tensor
    in_front: Tensor
    measured: Tensor
    known_normal: Tensor
    points: Tensor
    drawn: Tensor


def compare(R: Tensor, t: Tensor, scene: SurfaceMap, shape: ShapeModel, count: int, halo: bool = False) -> Agreement:
    """Compare the first `count` visible points of poses R (h, 3, 3), t (h, 3); `halo` takes the band around them."""
    source = shape.halo if halo else shape.visible
    drawn = torch.baddbmm(t[:, None], source[:, :count].index_select(0, shape.view_of(R, t)), R.transpose(1, 2))
    pixels, inside = scene.pixels_of(drawn)
    rows = scene.at(pixels)
    z, normal, nearest = rows[..., 2], rows[..., 3:6], rows[..., 6]
    measured = inside & (z > 0)
    points = torch.bmm(rows[..., :3] - t[:, None], R)
    distance, gradient = shape.field.look_up(points)
    depth = drawn[..., 2]
    return Agreement(
        distance=distance,
        facing=torch.linalg.vecdot(torch.bmm(normal, R), gradient),
        gap=torch.where(inside & (nearest > 0), nearest - depth, 0.0),
        in_front=torch.where(measured, depth - z, 0.0),
        measured=measured,
        known_normal=measured & (normal[..., 2] != 0),
        points=points,
        drawn=drawn,
    )


def facing_camera(R: Tensor, t: Tensor, a: Agreement, shape: ShapeModel) -> Tensor:
    """Which visible points (h, p) of the poses compared in `a` face the camera."""
    normals = shape.visible_normals[:, : a.drawn.shape[1]].index_select(0, shape.view_of(R, t))
    away = torch.linalg.vecdot(torch.bmm(normals, R.transpose(1, 2)), a.drawn)
    return -away > 0.1 * a.drawn[..., 2]


def soft_score(R: Tensor, t: Tensor, scene: SurfaceMap, shape: ShapeModel, count: int, tolerance: float) -> Tensor:
    """Score (h,) of poses at a coarse tolerance in units, for ranking: agreement less 0.7 of what was seen through."""
    R, t = R.contiguous(), t.contiguous()
    poses = KernelPoses(R.numpy(), t.numpy(), shape.view_of(R, t).numpy())
    visible, table = shape.visible.numpy(), scene.table.numpy()
    scores = _soft_scores(poses, visible, count, table, scene.camera, np.float32(tolerance), shape.field.arrays)
    return torch.from_numpy(scores)


@numba.njit(cache=True)
def _soft_scores(poses, visible, count, table, camera, tolerance, field):  # type: ignore[no-untyped-def]
    """The loop of `soft_score`: as `compare`, point by point."""
    R, t, view = poses
    scores = np.zeros(len(R), np.float32)
    for i in range(len(R)):
        tx, ty, tz = t[i]
        total = np.float32(0.0)
        for k in range(count):
            px, py, pz = visible[view[i], k]
            x, y, z = turned(R, i, px, py, pz)
            depth = z + tz
            pixel = pixel_of(camera, x + tx, y + ty, depth)
            if pixel < 0:
                continue
            if table[pixel, 6] > 0:
                through = (table[pixel, 6] - depth - tolerance) / tolerance
                total -= np.float32(0.7) * min(max(through, np.float32(0.0)), np.float32(1.0))
            if table[pixel, 2] <= 0:
                continue
            qx, qy, qz = turned_back(R, i, table[pixel, 0] - tx, table[pixel, 1] - ty, table[pixel, 2] - tz)
            distance, gx, gy, gz = distance_at(field.table, field.origin, field.step, field.shape, qx, qy, qz)
            near = np.float32(1.0) - (distance / tolerance) ** 2
            if near <= 0:
                continue
            facing = np.float32(0.5)
            if table[pixel, 5] != 0:
                nx, ny, nz = turned_back(R, i, table[pixel, 3], table[pixel, 4], table[pixel, 5])
                facing = max(nx * gx + ny * gy + nz * gz, np.float32(0.0))
            total += near * facing
        scores[i] = total / count
    return scores
