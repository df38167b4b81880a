"""How well poses agree with a depth image, point by point; the common measure of scoring and verification."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from perception.shape_model import ShapeModel
from perception.surface_map import SurfaceMap


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


def soft_score(
    R: Tensor, t: Tensor, scene: SurfaceMap, shape: ShapeModel, count: int, tolerance: float, chunk: int = 512
) -> Tensor:
    """Score (h,) of poses at a coarse tolerance in units, for ranking: agreement less half of what was seen through."""
    scores = []
    for first in range(0, len(R), chunk):
        part = slice(first, first + chunk)
        a = compare(R[part], t[part], scene, shape, count)
        near = (1.0 - (a.distance / tolerance).square()).clamp_(min=0.0)
        agree = near * torch.where(a.known_normal, a.facing.clamp(min=0.0), 0.5) * a.measured
        seen_through = ((a.gap - tolerance) / tolerance).clamp_(0.0, 1.0)
        scores.append((agree - 0.7 * seen_through).mean(1))
    return torch.cat(scores) if scores else torch.zeros(0)
