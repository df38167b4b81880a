"""The reasons why a grasp was ruled out; names are stable, since records, reports and `explain` show them."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

CHOSEN = "chosen"


class Verdict(StrEnum):
    """The first reason that ruled out one grasp pose of one estimate, in the order of the checks."""

    DISABLED = "disabled"
    SCORE = "score"
    AVOIDED = "avoided"
    COVERED = "covered"
    NO_PLACE = "no_place"
    TOLERANCE = "tolerance"
    TILT = "tilt"
    GRIPPER_BIN = "gripper_bin"
    GRIPPER_HEAP = "gripper_heap"
    NO_IK = "no_ik"
    JOINT_LIMIT = "joint_limit"
    SINGULARITY = "singularity"
    TORQUE = "torque"
    HELD_BIN = "held_bin"
    PATH_BLOCKED = "path_blocked"
    TRIAL = "rehearsal"  # of the grasp oracle; the value is kept because stored records contain it
    OUTRANKED = "outranked"


VERDICTS = np.dtype(f"<U{max(map(len, Verdict))}")
"""Type of arrays of verdicts and empty strings: numpy truncates longer text without an error."""
MEANING = {
    Verdict.DISABLED: "the grasp point is switched off, or made for another gripper",
    Verdict.SCORE: "the estimate's score is too low",
    Verdict.AVOIDED: "a pick failed there recently",
    Verdict.COVERED: "too much lies on the workpiece",
    Verdict.NO_PLACE: "the workpiece cannot be placed as required from this grasp; it needs a regrasp",
    Verdict.TOLERANCE: "the pose error exceeds the tolerance of the grasp point",
    Verdict.TILT: "the approach is tilted too far",
    Verdict.GRIPPER_BIN: "the gripper would collide with the bin",
    Verdict.GRIPPER_HEAP: "the gripper would collide with neighbouring workpieces",
    Verdict.NO_IK: "out of the arm's reach",
    Verdict.JOINT_LIMIT: "a joint would exceed its range",
    Verdict.SINGULARITY: "the arm would be too close to a singularity",
    Verdict.TORQUE: "a motor would be too weak for the load",
    Verdict.HELD_BIN: "the held workpiece would touch the bin during the lift",
    Verdict.PATH_BLOCKED: "no collision-free motion was found",
    Verdict.TRIAL: "it did not hold in the physics trial of the grasp oracle",
    Verdict.OUTRANKED: "enough better candidates were found",
}
