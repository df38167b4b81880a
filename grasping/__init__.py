"""Grasp points on the CAD become ranked grasp candidates, each with the reason that ruled it out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pickproof.cell.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from pickproof.grasping.candidates import GraspCandidate
    from pickproof.grasping.grasp_points import GraspPoint, GraspPoses, load_grasps, read_table
    from pickproof.grasping.ranking import GraspingConfig
    from pickproof.grasping.verdict import Verdict

__all__ = [
    "GraspCandidate",
    "GraspPoint",
    "GraspPoses",
    "GraspingConfig",
    "Verdict",
    "load_grasps",
    "read_table",
]

_MODULES = {
    "GraspCandidate": "candidates",
    "GraspPoint": "grasp_points",
    "GraspPoses": "grasp_points",
    "GraspingConfig": "ranking",
    "Verdict": "verdict",
    "load_grasps": "grasp_points",
    "read_table": "grasp_points",
}

__getattr__, __dir__ = lazy_exports(__name__, _MODULES)
