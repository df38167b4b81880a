"""Depth images to workpiece poses: PS6D, refinement and verification. The only folder that imports torch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pickproof.cell.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from pickproof.perception.estimate import Perception
    from pickproof.perception.pose_estimate import PoseEstimate
    from pickproof.perception.refinement.refine import RefineConfig, RefineResult

__all__ = [
    "Perception",
    "PoseEstimate",
    "RefineConfig",
    "RefineResult",
]

_MODULES = {
    "Perception": "estimate",
    "PoseEstimate": "pose_estimate",
    "RefineConfig": "refinement.refine",
    "RefineResult": "refinement.refine",
}

__getattr__, __dir__ = lazy_exports(__name__, _MODULES)
