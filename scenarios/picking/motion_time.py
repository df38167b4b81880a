"""The rank's term of motion time: time of the arm from its waiting pose to a grasp."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pickproof.cell.frames import Array, invert
from pickproof.grasping.candidates import Selection
from pickproof.grasping.ranking import GraspingConfig
from pickproof.robots.kinematics.inverse import FRONT, inverse
from pickproof.robots.kinematics.model import RobotModel
from pickproof.robots.motion.timing import rest_to_rest

LONGEST = 1.0  # [s] that are as bad as out of reach


def with_motion(
    selection: Selection, robot: RobotModel, q_start: Array, T_flange_tool: Array, weights: GraspingConfig
) -> Selection:
    """The selection ranked again with the term `motion`: 1 for no motion at all, 0 for LONGEST or out of reach.

    The time is the lower bound of any motion from q_start (6,) [rad]. It distinguishes a grasp from the same one with
    the jaws rotated by 180 degrees; planning follows later.
    """
    if not selection.candidates:
        return selection
    Ts = np.stack([c.T_world_tool for c in selection.candidates]) @ invert(T_flange_tool)
    found = inverse(robot, Ts, q_start)
    front = list(FRONT)
    seconds = rest_to_rest(robot, found.q[:, front] - q_start)
    seconds = np.where(found.valid[:, front], seconds, LONGEST).min(axis=1)
    ranked = []
    for candidate, time in zip(selection.candidates, seconds, strict=True):
        terms = candidate.terms | {"motion": float(np.clip(1.0 - time / LONGEST, 0.0, 1.0))}
        ranked.append(replace(candidate, terms=terms, rank=float(weights.rank(terms))))
    return replace(selection, candidates=sorted(ranked, key=lambda c: -c.rank))
