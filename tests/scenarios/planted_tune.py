"""A stand-in for trying a grasp, importable by name in worker processes: it holds best 3 mm along x."""

from __future__ import annotations

import numpy as np

from pickproof.scenarios.tuning.grasp_objective import GraspTask
from pickproof.scenarios.tuning.optimizer import Told

BEST = np.array([0.003, 0.0, 0.0])


def trial(task: GraspTask) -> Told:
    off = float(np.linalg.norm(np.asarray(task.point.centre) - BEST)) / 0.003
    share = max(0.0, 1.0 - off / 4)
    return Told(
        share, {"share": share, "trials": 1, "slip_mm": 0.0, "reason": "" if share > 0.9 else "closed on nothing"}
    )
