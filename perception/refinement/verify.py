"""From examined poses to those that are believed: settle rivals, then apply the thresholds.

Takes `Claims`, poses with their evidence and calibrated score; gives the claims that stand. What the depth image says
of one pose is in `evidence.py`, how two poses conflict in `rivalry.py`, and the score in `score_model.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.refinement.config import VerifyConfig
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.evidence import Evidence, Floats, examine, inlier_tolerance
from pickproof.perception.refinement.rivalry import rivalry, suppress

EXPLAINED_TOLERANCE = 2.0
"""Distance in inlier tolerances within which a measured point is explained by a pose."""


@dataclass(frozen=True)
class Claims:
    """Examined poses: rotations (h, 3, 3), positions (h, 3) in units, evidence and calibrated score (h,)."""

    rotations: Tensor
    positions: Tensor
    evidence: Evidence
    scores: Floats

    def __len__(self) -> int:
        return len(self.scores)

    def select(self, index: np.ndarray) -> Claims:
        """The claims at `index`."""
        i = torch.from_numpy(index)
        return Claims(self.rotations[i], self.positions[i], self.evidence.select(index), self.scores[index])

    def join(self, other: Claims) -> Claims:
        """These claims, then others."""
        return Claims(
            torch.cat([self.rotations, other.rotations]),
            torch.cat([self.positions, other.positions]),
            self.evidence.join(other.evidence),
            np.concatenate([self.scores, other.scores]),
        )


def settle(claims: Claims, scene: SurfaceMap, shape: ShapeModel, config: VerifyConfig) -> NDArray[np.int64]:
    """Indices of the claims that have no better rival, best first."""
    shared, overlap = rivalry(claims.rotations, claims.positions, scene, shape, config)
    return np.asarray(suppress(np.argsort(-claims.scores, kind="stable"), shared, overlap, config), dtype=np.int64)


def accepted(claims: Claims, standing: NDArray[np.int64], config: VerifyConfig, threshold: float) -> Claims:
    """Of the claims at the indices `standing`, (s,) from `settle`, those that pass every threshold.

    `threshold` is that of the score where the configuration has none.
    """
    good = claims.scores >= (config.min_score if config.min_score is not None else threshold)
    good &= (claims.evidence.ratio >= config.min_ratio) & (claims.evidence.inliers >= config.min_visible)
    return claims.select(standing[good[standing]])


def on_surface(
    points: np.ndarray, claims: Claims, scene: SurfaceMap, shape: ShapeModel, config: VerifyConfig
) -> np.ndarray:
    """Which camera points (m, 3), in units, lie on the surface of any claim (m,)."""
    p = torch.from_numpy(points.astype(np.float32))
    in_part = torch.matmul(p[None] - claims.positions[:, None], claims.rotations)
    on = shape.field.look_up(in_part)[0].abs() < EXPLAINED_TOLERANCE * inlier_tolerance(scene, config)
    return np.asarray(on.any(0).numpy())


__all__ = [
    "Claims",
    "Evidence",
    "VerifyConfig",
    "accepted",
    "examine",
    "inlier_tolerance",
    "on_surface",
    "rivalry",
    "settle",
    "suppress",
]
