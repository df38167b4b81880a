"""The stable vocabulary of why a way to take a workpiece was ruled out; records, reports and `explain` show it."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

CHOSEN = "chosen"


class Verdict(StrEnum):
    """The first reason that ruled out one grasp pose of one estimate, in the order in which they are looked at."""

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
    TRIAL = "rehearsal"  # of the grasp oracle; the value stays, stored records hold it
    OUTRANKED = "outranked"


VERDICTS = np.dtype(f"<U{max(map(len, Verdict))}")
"""Of arrays that hold verdicts, or the empty string: numpy cuts longer text without a word."""
MEANING = {
    Verdict.DISABLED: "the grasp point is switched off, or made for another gripper",
    Verdict.SCORE: "the estimate's score is too low",
    Verdict.AVOIDED: "a pick failed there lately",
    Verdict.COVERED: "too much lies on the workpiece",
    Verdict.NO_PLACE: "held so the workpiece cannot be put down as wanted; it would have to be gripped anew",
    Verdict.TOLERANCE: "the estimate is less certain than the grasp point tolerates",
    Verdict.TILT: "the approach leans too far",
    Verdict.GRIPPER_BIN: "the gripper has no room for the bin",
    Verdict.GRIPPER_HEAP: "the gripper has no room for what lies beside",
    Verdict.NO_IK: "out of the arm's reach",
    Verdict.JOINT_LIMIT: "a joint would leave its range",
    Verdict.SINGULARITY: "the arm would stand too close to a singularity",
    Verdict.TORQUE: "a motor would be too weak for the load",
    Verdict.HELD_BIN: "the held workpiece would touch the bin on the way out",
    Verdict.PATH_BLOCKED: "no motion without collision was found",
    Verdict.TRIAL: "it did not hold when the grasp oracle tried it in the physics",
    Verdict.OUTRANKED: "better ones were enough",
}
