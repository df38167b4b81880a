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

DEPTH_LOSS = 0.5  # loss of robustness per step of depth after the preferred one
SLIDE_LOSS = 10.0  # [1/m] loss of robustness for a shift from the grasp point's centre
ERROR_LOSS = 0.5  # loss of robustness when the pose error equals the tolerance of the grasp point


class GraspingConfig(Config):
    """Weights of the ranking of grasp candidates; each term is in [0, 1]."""

    weight_score: float = Field(default=1.0, ge=0, description="weight of the estimate's score")
    weight_height: float = Field(default=1.0, ge=0, description="weight of the workpiece's height in the heap")
    weight_upright: float = Field(default=0.5, ge=0, description="weight of closeness to the preferred approach")
    weight_priority: float = Field(default=0.5, ge=0, description="weight of the grasp point's priority")
    weight_robustness: float = Field(default=0.5, ge=0, description="weight of tolerance to pose errors")
    weight_clearance: float = Field(default=0.75, ge=0, description="weight of clearance to neighbours")
    weight_uncovered: float = Field(default=2.0, ge=0, description="weight of a workpiece without others on it")
    weight_alone: float = Field(default=1.0, ge=0, description="weight of nothing else between the fingers")
    weight_motion: float = Field(default=0.25, ge=0, description="weight of a short arm motion")
    min_score: float = Field(default=0.0, ge=0, le=1, description="smallest score of an estimate that is gripped")
    min_uncovered: float = Field(default=0.0, ge=0, le=1, description="smallest term `uncovered` that is gripped")
    max_overlap_mm2: float | None = Field(
        default=None, ge=0, description="[mm2] largest area, from above, under another estimate; null: no limit"
    )
    max_candidates: int = Field(default=200, ge=1, le=1000, description="number of candidates passed to planning")

    def rank(self, terms: Mapping[str, float | Array]) -> Array:
        """Weighted sum of terms."""
        return np.asarray(sum(getattr(self, f"weight_{name}") * value for name, value in terms.items()))


def robustness(poses: GraspPoses, error: float) -> Array:
    """Term (n,): how well each pose tolerates an error of the estimate, expected to be `error` [m].

    The share of disturbances at which the grasp point held, reduced for a depth after the preferred one, for a shift
    from its centre, and for a pose error close to its tolerance.
    """
    own = np.array([p.robustness for p in poses.points])[poses.index]
    used = np.clip(error / np.array([p.tolerance for p in poses.points])[poses.index], 0.0, 1.0)
    where = np.clip(1.0 - DEPTH_LOSS * poses.depth_rank - SLIDE_LOSS * poses.offset, 0.0, 1.0)
    return np.asarray(own * where * (1.0 - ERROR_LOSS * used))
