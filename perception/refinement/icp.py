"""Registration of many hypotheses at once: measured points against the CAD.

Scene points are drawn through the image: the precomputed points that a pose shows the camera are projected, and what
was measured at their pixels is carried into the CAD frame. That is point-to-plane ICP (Chen and Medioni 1992) without
a search tree, so the association costs one gather a point. Far from the answer a measured point belongs to the plane of
the CAD point that was projected (projective association, Blais and Levine 1995): the nearest surface of a thin wall is
soon its other side. Near the answer the distance field gives distance and normal of the nearest surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.normal_equations import (
    Association,
    CadPoints,
    EdgeSearch,
    Outline,
    VoteWeights,
    rim_terms,
    surface_terms,
)
from pickproof.perception.refinement.numba_kernels import KernelPoses


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
DAMPING = np.array([3e-3, 3e-3, 3e-3, 1e-2, 1e-2, 1e-2], np.float32)
"""Damping of rotation and translation in the normal equations, for a total weight of 20 points."""
MIN_FACING = 0.4
"""Least cosine between the measured normal and that of the CAD."""


def register(
    R: Tensor, t: Tensor, scene: SurfaceMap, shape: ShapeModel, stages: tuple[IcpStage, ...]
) -> tuple[Tensor, Tensor]:
    """Refine poses R (h, 3, 3), t (h, 3) in units; poses that see nothing stay where they are."""
    R, t = R.contiguous(), t.contiguous()
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
    """One Gauss-Newton step: d(distance) / d(twist) in the CAD frame is -(w x y + v) for a turn w and a shift v."""
    poses = KernelPoses(R.numpy(), t.numpy(), shape.view_of(R, t).numpy())
    cad = CadPoints(shape.visible.numpy(), shape.visible_normals.numpy(), stage.points)
    rule = Association(np.float32(threshold), np.float32(MIN_FACING), stage.projective)
    votes = VoteWeights(
        scene.nearest_vote.numpy(),
        scene.centres.numpy() if stage.by_votes else np.zeros((0, 3), np.float32),
        np.float32(VOTE_REACH),
        np.float32(VOTE_FLOOR),
        *shape.elongation,
    )
    # Tukey's weight: an occluder or the floor at the threshold has weight 0
    hessian, slope = surface_terms(poses, cad, scene.table.numpy(), scene.camera, shape.field.arrays, rule, votes)
    if stage.rim > 0:
        of_rim = _rim_terms(poses, scene, shape, stage)
        hessian, slope = hessian + of_rim[0], slope + of_rim[1]
    damping = np.diag(DAMPING * stage.points * 0.05 + 1e-4)
    twist = torch.linalg.solve(torch.from_numpy(hessian + damping), torch.from_numpy(slope))
    limit = 2.0 * threshold
    twist = twist * (limit / twist.abs().amax(1, keepdim=True).clamp(min=limit))
    turn = _exp(twist[:, :3])
    return R @ turn, t + (R @ twist[:, 3:, None])[..., 0]


def _rim_terms(
    poses: KernelPoses, scene: SurfaceMap, shape: ShapeModel, stage: IcpStage
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations (h, 6, 6), (h, 6) of the outline: move it to where the measured depth drops.

    Point-to-plane distances leave a part that lies flat free to slide. Across each outline point the depth image is
    read from inside outward; the edge is where the last measurement at the outline's depth is followed by one behind
    it. Where something in front comes between, or the surface goes on, there is no edge to be seen. (Edge search along
    normals: Harris and Stennett, RAPID, 1990.)
    """
    half_width = stage.rim * shape.fineness
    stride = RIM_STRIDE_COARSE if half_width > RIM_COARSE else 1
    drop, strength = np.float32(RIM_DROP * shape.thickness), np.float32(RIM_WEIGHT * stage.points)
    outline = Outline(shape.rim.numpy(), shape.rim_outward.numpy(), stride)
    search = EdgeSearch(np.float32(half_width), RIM_STEPS, drop, strength, scene.depth.numpy(), scene.camera)
    found: tuple[np.ndarray, np.ndarray] = rim_terms(poses, outline, search)
    return found


def _exp(w: Tensor) -> Tensor:
    """Rotations (h, 3, 3) of rotation vectors (h, 3) (Rodrigues)."""
    angle = w.norm(dim=1).clamp(min=1e-9)
    k = w / angle[:, None]
    zero = torch.zeros_like(angle)
    K = torch.stack([zero, -k[:, 2], k[:, 1], k[:, 2], zero, -k[:, 0], -k[:, 1], k[:, 0], zero], 1).reshape(-1, 3, 3)
    return torch.eye(3) + angle.sin()[:, None, None] * K + (1 - angle.cos())[:, None, None] * (K @ K)
