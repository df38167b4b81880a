"""Which of several poses on the same surface stands: one surface has one owner, and no part is inside another.

Takes poses and the measured surface; gives how far each two of them conflict, and the poses that have no better rival.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.refinement.config import VerifyConfig
from pickproof.perception.refinement.depth_agreement import compare
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.evidence import inlier_tolerance

POINTS = 160
"""CAD points of a pose that are compared with its rivals."""
SHARED_TOLERANCE = 1.5
"""Distance in inlier tolerances within which a point that confirms one pose lies on another too."""

Floats = NDArray[np.float64]


def rivalry(R: Tensor, t: Tensor, scene: SurfaceMap, shape: ShapeModel, config: VerifyConfig) -> tuple[Floats, Floats]:
    """How claims conflict: shared (h, h) and overlap (h, h) of poses R (h, 3, 3), t (h, 3).

    shared[a, b]: share of the surface that confirms a and lies on b too. overlap[a, b]: share of the surface of a
    that is deep inside b.
    """
    h = len(R)
    shared, overlap = np.zeros((h, h)), np.zeros((h, h))
    tolerance = inlier_tolerance(scene, config)
    reach = 2 * float(np.linalg.norm(shape.points, axis=1).max())
    near = torch.cdist(t, t, compute_mode="donot_use_mm_for_euclid_dist") < reach
    near.fill_diagonal_(False)
    a, b = torch.nonzero(near, as_tuple=True)
    if len(a) == 0:
        return shared, overlap
    seen = compare(R, t, scene, shape, POINTS)
    confirms = seen.measured & (seen.distance.abs() < tolerance)
    # of frame a into frame b
    R_ba = torch.bmm(R[b].transpose(1, 2), R[a])
    t_ba = torch.bmm(R[b].transpose(1, 2), (t[a] - t[b])[:, :, None]).transpose(1, 2)
    in_b = torch.bmm(seen.points[a], R_ba.transpose(1, 2)) + t_ba
    both = confirms[a] & (shape.field.look_up(in_b)[0].abs() < SHARED_TOLERANCE * tolerance)
    shared[a, b] = (both.sum(1) / confirms[a].sum(1).clamp(min=1)).numpy()
    stride = max(1, len(shape.points) // POINTS)
    surface = torch.from_numpy(shape.points[::stride].astype(np.float32))
    in_b = surface[None] @ R_ba.transpose(1, 2) + t_ba
    deep = shape.field.look_up(in_b)[0] < -config.overlap_depth * shape.thickness
    overlap[a, b] = deep.double().mean(1).numpy()
    return shared, overlap


def suppress(order: np.ndarray, shared: Floats, overlap: Floats, config: VerifyConfig) -> list[int]:
    """Go through poses from the best down; keep those that neither claim owned surface nor enter a kept one."""
    kept: list[int] = []
    for i in order:
        if kept:
            owned = shared[i, kept].sum()
            collides = max(overlap[i, kept].max(), overlap[kept, i].max())
            if owned > config.max_shared or collides > config.max_overlap:
                continue
        kept.append(int(i))
    return kept
