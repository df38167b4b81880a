"""The rank's term of motion time: how far the arm's joints have to turn from home to a grasp."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cell.frames import Array, invert
from grasping.candidates import Selection
from grasping.ranking import GraspingConfig
from robots.inverse import FRONT, inverse
from robots.model import RobotModel

LONGEST = 1.0  # [s] at full joint speed that is as bad as out of reach


def with_motion(selection: Selection, robot: RobotModel, T_flange_tool: Array, weights: GraspingConfig) -> Selection:
    """The selection ranked anew with the term `motion`: 1 for no way at all, 0 for LONGEST or out of reach.

    The time is that of the slowest joint at its top speed, the lower bound of any motion; planning comes later.
    """
    if not selection.candidates:
        return selection
    Ts = np.stack([c.T_world_tool for c in selection.candidates]) @ invert(T_flange_tool)
    found = inverse(robot, Ts)
    front = list(FRONT)
    seconds = (np.abs(found.q[:, front] - robot.home) / robot.velocity).max(axis=-1)
    seconds = np.where(found.valid[:, front], seconds, LONGEST).min(axis=1)
    ranked = []
    for candidate, time in zip(selection.candidates, seconds, strict=True):
        terms = candidate.terms | {"motion": float(np.clip(1.0 - time / LONGEST, 0.0, 1.0))}
        ranked.append(replace(candidate, terms=terms, rank=float(weights.rank(terms))))
    return replace(selection, candidates=sorted(ranked, key=lambda c: -c.rank))
