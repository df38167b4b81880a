"""Slender parts along their axis, where registration hardly holds them: several places are tried and the best stays."""

from __future__ import annotations

import numpy as np
import torch

from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.refinement.depth_agreement import soft_score
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.search.poses import Poses

REACH, STEP = 0.2, 0.02
"""Farthest place and distance of two of them, in units."""


def slid(poses: Poses, surface: SurfaceMap, shape: ShapeModel, points: int, tolerance: float) -> Poses:
    """Each pose at the place along its axis that agrees best with the depth image; scores are those of the places.

    Args:
        points, tolerance: of `soft_score`, the tolerance in units.
    """
    if not shape.slender or not len(poses):
        return poses
    count = round(REACH / STEP)
    steps = torch.from_numpy((STEP * np.arange(-count, count + 1)).astype(np.float32))
    axis = poses.rotations @ torch.from_numpy(shape.long_axis.astype(np.float32))
    places = poses.positions[:, None] + steps[None, :, None] * axis[:, None]
    R = poses.rotations.repeat_interleave(len(steps), dim=0)
    scores = soft_score(R, places.reshape(-1, 3), surface, shape, points, tolerance).numpy().reshape(-1, len(steps))
    best = scores.argmax(1)
    rows = np.arange(len(poses))
    return Poses(poses.rotations, places[rows, best].contiguous(), scores[rows, best])
