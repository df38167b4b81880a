"""Registration of many hypotheses at once: measured points against the CAD.

Scene points are drawn through the image: the precomputed points that a pose shows the camera are projected, and what
was measured at their pixels is carried into the CAD frame. That is point-to-plane ICP (Chen and Medioni 1992) without
a search tree, so the association costs one gather a point. Far from the answer a measured point belongs to the plane of
the CAD point that was projected (projective association, Blais and Levine 1995): the nearest surface of a thin wall is
soon its other side. Near the answer the distance field gives distance and normal of the nearest surface.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from perception.shape_model import ShapeModel
from perception.surface_map import SurfaceMap


@dataclass(frozen=True)
class IcpStage:
    """Iterations with one threshold.

    Attributes:
        threshold: distance in units beyond which a measured point does not belong; multiples of the sensor's sigma
            where `in_sigmas`.
        iterations: Gauss-Newton steps.
        points: scene points a hypothesis.
        projective: measured points belong to the CAD points at their pixels, not to the nearest surface.
        rim: half width in units of the search for the part's edge across its outline; 0 for none.
        by_votes: weigh points by whether the vote nearest to them predicted this part.
    """

    threshold: float
    iterations: int
    points: int
    projective: bool = False
    in_sigmas: bool = False
    by_votes: bool = False
    rim: float = 0.0


COARSE = (
    IcpStage(0.12, 2, 128, projective=True, by_votes=True, rim=0.12),
    IcpStage(0.06, 2, 128, projective=True, by_votes=True, rim=0.12),
)
FINE = (
    IcpStage(0.05, 3, 192, projective=True, by_votes=True, rim=0.08),
    IcpStage(0.03, 3, 192, projective=True, rim=0.05),
)
LAST = (
    IcpStage(0.02, 1, 256),
    IcpStage(6.0, 2, 256, in_sigmas=True, rim=0.025),
    IcpStage(5.0, 1, 384, in_sigmas=True),
)
RIM_STEPS = 15
RIM_COARSE, RIM_STRIDE_COARSE = 0.1, 2
"""Searches wider than the first use every second outline point."""
RIM_DROP = 0.5
"""Step in depth that ends a surface, in thicknesses of the part."""
RIM_WEIGHT = 0.3
SLENDER_ITERATIONS = 3
"""Factor of the iterations for slender parts, whose thresholds are tighter."""
VOTE_REACH, VOTE_FLOOR = 0.25, 0.05
MIN_FACING = 0.4
"""Least cosine between the measured normal and that of the CAD."""


def register(
    R: Tensor, t: Tensor, scene: SurfaceMap, shape: ShapeModel, stages: tuple[IcpStage, ...]
) -> tuple[Tensor, Tensor]:
    """Refine poses R (h, 3, 3), t (h, 3) in units; poses that see nothing stay where they are."""
    for stage in stages:
        fine = shape.fineness
        least = 0.006 * fine
        threshold = max(stage.threshold * scene.sigma, least) if stage.in_sigmas else stage.threshold * fine
        for _ in range(stage.iterations * (SLENDER_ITERATIONS if shape.slender else 1)):
            R, t = _step(R, t, scene, shape, stage, threshold)
    return R, t


def _step(
    R: Tensor, t: Tensor, scene: SurfaceMap, shape: ShapeModel, stage: IcpStage, threshold: float
) -> tuple[Tensor, Tensor]:
    view = shape.view_of(R, t)
    drawn = shape.visible[:, : stage.points].index_select(0, view)
    pixels, inside = scene.pixels_of(torch.baddbmm(t[:, None], drawn, R.transpose(1, 2)))
    rows = scene.at(pixels)
    measured = rows[..., :3]
    points = torch.bmm(measured - t[:, None], R)  # R^T (s - t), one row a point
    if stage.projective:
        gradient = shape.visible_normals[:, : stage.points].index_select(0, view)
        distance = ((points - drawn) * gradient).sum(-1)
    else:
        distance, gradient = shape.field.look_up(points)
    facing = (torch.bmm(rows[..., 3:6], R) * gradient).sum(-1)
    # Tukey's weight: an occluder or the floor one threshold away has no say
    weight = (1.0 - (distance / threshold).square()).clamp_(min=0.0).square_()
    weight = weight * (inside & (measured[..., 2] > 0) & (facing > MIN_FACING))
    if stage.by_votes:
        weight = weight * scene.membership(pixels, shape, R, t, VOTE_REACH, VOTE_FLOOR)
    # d(distance) / d(twist) in the CAD frame: a turn w and a shift v of the part move the point by -(w x y + v)
    jacobian = torch.cat([torch.linalg.cross(points, gradient), gradient], -1)
    weighted = jacobian * weight[..., None]
    hessian = torch.bmm(weighted.transpose(1, 2), jacobian)
    slope = torch.bmm(weighted.transpose(1, 2), distance[..., None])
    if stage.rim > 0:
        hessian_rim, slope_rim = _rim_terms(R, t, scene, shape, replace(stage, rim=stage.rim * shape.fineness))
        hessian, slope = hessian + hessian_rim, slope + slope_rim
    damping = torch.tensor([3e-3, 3e-3, 3e-3, 1e-2, 1e-2, 1e-2]) * stage.points * 0.05 + 1e-4
    twist = torch.linalg.solve(hessian + torch.diag(damping), slope)[..., 0]
    limit = 2.0 * threshold
    twist = twist * (limit / twist.abs().amax(1, keepdim=True).clamp(min=limit))
    turn = _exp(twist[:, :3])
    return R @ turn, t + (R @ twist[:, 3:, None])[..., 0]


def _rim_terms(R: Tensor, t: Tensor, scene: SurfaceMap, shape: ShapeModel, stage: IcpStage) -> tuple[Tensor, Tensor]:
    """Normal equations (h, 6, 6), (h, 6, 1) of the outline: move it to where the measured depth drops.

    Point-to-plane distances leave a part that lies flat free to slide. Across each outline point the depth image is
    read from inside outward; the edge is where the last measurement at the outline's depth is followed by one behind
    it. Where something in front comes between, or the surface goes on, there is no edge to be seen. (Edge search along
    normals: Harris and Stennett, RAPID, 1990.)
    """
    view = shape.view_of(R, t)
    stride = RIM_STRIDE_COARSE if stage.rim > RIM_COARSE else 1
    rim, outward = shape.rim[:, ::stride].index_select(0, view), shape.rim_outward[:, ::stride].index_select(0, view)
    Rt = R.transpose(1, 2)
    points, direction = torch.baddbmm(t[:, None], rim, Rt), torch.bmm(outward, Rt)
    s = torch.linspace(-stage.rim, stage.rim, RIM_STEPS)
    samples = points[:, :, None] + s[:, None] * direction[:, :, None]
    pixels, inside = scene.pixels_of(samples)
    z = scene.depth.index_select(0, pixels.reshape(-1)).reshape(pixels.shape)
    drop = z - points[..., 2:]
    known = inside & (z > 0)
    step = RIM_DROP * shape.thickness
    index = torch.arange(RIM_STEPS, dtype=torch.int32).expand(drop.shape)
    nothing = torch.tensor(-1, dtype=torch.int32)
    behind = known & (drop > step)
    last_on = torch.where(known & (drop.abs() <= step), index, nothing).cummax(-1).values
    last_front = torch.where(known & (drop < -step), index, nothing).cummax(-1).values
    last_behind = torch.where(behind, index, nothing).cummax(-1).values
    before = torch.cat([nothing.expand(*drop.shape[:-1], 1), last_behind[..., :-1]], -1)
    edge = behind & (last_on >= 0) & (last_on > before) & (last_on > last_front)
    # pixels at a step go missing on both of its sides, so the edge is in the middle of a narrow gap; a wide one is the
    # projector's shadow, which lies behind the edge
    spacing = 2.0 * stage.rim / (RIM_STEPS - 1)
    pixel = points[..., 2:] / scene.intrinsics.fx
    half_gap = 0.5 * spacing * (index - last_on)
    position = s[last_on.clamp(min=0).long()] + torch.where(half_gap < 2.0 * pixel, half_gap, pixel) + 0.25 * pixel
    distance, which = torch.where(edge, position.abs(), 1e3).min(-1)
    offset = position.gather(-1, which[..., None])[..., 0]
    # an edge is found to one step of the search; less than that is no reason to move
    offset = offset.sign() * (offset.abs() - spacing).clamp_(min=0.0)
    weight = (1.0 - (distance / (1.2 * stage.rim)).square()).clamp_(min=0.0).square_()
    weight = weight * (RIM_WEIGHT * stage.points / rim.shape[1])
    jacobian = torch.cat([torch.linalg.cross(rim, outward), outward], -1)
    weighted = jacobian * weight[..., None]
    return torch.bmm(weighted.transpose(1, 2), jacobian), torch.bmm(weighted.transpose(1, 2), offset[..., None])


def _exp(w: Tensor) -> Tensor:
    """Rotations (h, 3, 3) of rotation vectors (h, 3) (Rodrigues)."""
    angle = w.norm(dim=1).clamp(min=1e-9)
    k = w / angle[:, None]
    zero = torch.zeros_like(angle)
    K = torch.stack([zero, -k[:, 2], k[:, 1], k[:, 2], zero, -k[:, 0], -k[:, 1], k[:, 0], zero], 1).reshape(-1, 3, 3)
    return torch.eye(3) + angle.sin()[:, None, None] * K + (1 - angle.cos())[:, None, None] * (K @ K)
