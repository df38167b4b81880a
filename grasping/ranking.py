"""The rank of a grasp: a weighted sum of terms, each in [0, 1] and 1 for the best.

The weights are here. The terms are computed in `estimate_checks.py`, `motion` in `scenarios/picking/motion_time.py`.
Planning follows the rank but for one thing: `scenarios/picking/plan_selection.py` takes the workpieces by turns.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydantic import Field

from pickproof.cell.config import Config
from pickproof.cell.frames import Array
from pickproof.grasping.grasp_points import GraspPoses

DEPTH_LOSS = 0.5  # of robustness for each depth less wanted than the first
SLIDE_LOSS = 10.0  # [1/m] of robustness for sliding away from the grasp point's centre
ERROR_LOSS = 0.5  # of robustness for an estimate as uncertain as the grasp point tolerates


class GraspingConfig(Config):
    """Weights of the ranking of grasp candidates; each term is in [0, 1]."""

    weight_score: float = Field(default=1.0, ge=0, description="of the estimate's score")
    weight_height: float = Field(default=1.0, ge=0, description="of the workpiece's height in the heap")
    weight_upright: float = Field(default=0.5, ge=0, description="of the approach that the grasp point prefers")
    weight_priority: float = Field(default=0.5, ge=0, description="of the grasp point's own priority")
    weight_robustness: float = Field(default=0.5, ge=0, description="of a grasp that tolerates an error of the pose")
    weight_clearance: float = Field(default=0.75, ge=0, description="of room between the gripper and what lies beside")
    weight_uncovered: float = Field(default=2.0, ge=0, description="of a workpiece on which nothing lies")
    weight_alone: float = Field(default=1.0, ge=0, description="of nothing else between the fingers")
    weight_motion: float = Field(default=0.25, ge=0, description="of a short way of the arm")
    min_score: float = Field(default=0.0, ge=0, le=1, description="of an estimate below which nothing is gripped")
    min_uncovered: float = Field(default=0.0, ge=0, le=1, description="of the term below which nothing is gripped")
    max_overlap_mm2: float | None = Field(
        default=None, ge=0, description="[mm2] of it that may lie under another believed one, from above; null: any"
    )
    max_candidates: int = Field(default=200, ge=1, le=1000, description="candidates handed on to planning, best first")

    def rank(self, terms: Mapping[str, float | Array]) -> Array:
        """Weighted sum of terms."""
        return np.asarray(sum(getattr(self, f"weight_{name}") * value for name, value in terms.items()))


def robustness(poses: GraspPoses, error: float) -> Array:
    """Term (n,): how well each pose tolerates an error of the estimate, expected to be `error` [m].

    The share of disturbances at which the grasp point held, less where the tips reach less deep or off its centre, and
    less the more of its tolerance the estimate uses up.
    """
    own = np.array([p.robustness for p in poses.points])[poses.index]
    used = np.clip(error / np.array([p.tolerance for p in poses.points])[poses.index], 0.0, 1.0)
    where = np.clip(1.0 - DEPTH_LOSS * poses.depth_rank - SLIDE_LOSS * poses.offset, 0.0, 1.0)
    return np.asarray(own * where * (1.0 - ERROR_LOSS * used))
