"""The tree that an attempt keeps: estimates -> grasp points -> the first reason that ruled each pose out."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from pickproof.grasping.candidates import Selection
from pickproof.grasping.verdict import CHOSEN, Verdict
from pickproof.robots.failure import Cause, PlanFailure, Stage
from pickproof.scenarios.picking.stages import Decision, Estimates, RuledOut
from pickproof.scenarios.picking.workcell import SOURCE

BY_THE_ARM = {
    Cause.OUT_OF_REACH: Verdict.NO_IK,
    Cause.JOINT_LIMIT: Verdict.JOINT_LIMIT,
    Cause.SINGULARITY: Verdict.SINGULARITY,
    Cause.TORQUE: Verdict.TORQUE,
}


def decision_tree(
    estimates: Estimates, selection: Selection, decision: Decision, tool: Collection[str]
) -> list[dict[str, Any]]:
    """What became of every grasp pose of every estimate, as JSON.

    Each estimate has `score`, `position` [m], `ruled_out` (grasp point -> verdict -> number of poses) and `candidates`:
    those that planning looked at and the best one, with rank, terms, verdict and, where planning refused, its detail.

    Args:
        tool: names of the gripper's boxes, to tell its collisions from the arm's.
    """
    tree: list[dict[str, Any]] = []
    for k, (T, score) in enumerate(zip(estimates.Ts_world_part, estimates.scores, strict=True)):
        position = [round(float(x), 4) for x in T[:3, 3]]
        ruled_out = {name: dict(counts) for name, counts in selection.ruled_out[k].items()}
        tree.append({"score": round(float(score), 4), "position": position, "ruled_out": ruled_out, "candidates": []})
    for i, candidate in enumerate(selection.candidates):
        of_estimate = tree[candidate.estimate]
        refused, name = decision.refused.get(i), candidate.point.name
        if candidate is decision.candidate:
            verdict = CHOSEN
        else:
            verdict = str(Verdict.OUTRANKED if refused is None else planning_verdict(refused, tool))
        if verdict == Verdict.OUTRANKED and of_estimate["candidates"]:
            of_point = of_estimate["ruled_out"].setdefault(name, {})
            of_point[verdict] = of_point.get(verdict, 0) + 1
            continue
        terms = {key: round(value, 3) for key, value in candidate.terms.items()}
        node = {"grasp": name, "rank": round(candidate.rank, 4), "terms": terms, "verdict": verdict}
        of_estimate["candidates"].append(node if refused is None else node | {"detail": str(refused)})
    return tree


def planning_verdict(failure: PlanFailure | RuledOut, tool: Collection[str]) -> Verdict:
    """The verdict on a grasp that was refused when its turn came."""
    if isinstance(failure, RuledOut):
        return failure.verdict
    if failure.cause in BY_THE_ARM:
        return BY_THE_ARM[failure.cause]
    who, what = failure.refusal.contact or ("", "")
    if who == "held" and what.startswith(f"{SOURCE}_"):
        return Verdict.HELD_BIN
    at_the_grasp = failure.stage == Stage.GRASP or (failure.stage == Stage.APPROACH and failure.refusal.on_line)
    if at_the_grasp and who in tool:
        if what.startswith(f"{SOURCE}_"):
            return Verdict.GRIPPER_BIN
        if what == "pile":
            return Verdict.GRIPPER_HEAP
    return Verdict.PATH_BLOCKED
