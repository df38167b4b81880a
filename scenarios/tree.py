"""The tree that an attempt keeps: estimates -> grasp points -> the first reason that ruled each pose out."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection
from typing import TYPE_CHECKING, Any

from grasping.candidates import Selection
from grasping.verdict import CHOSEN, Verdict
from scenarios.workcell import SOURCE

if TYPE_CHECKING:
    from scenarios.pick import Decision, Estimates

BY_THE_ARM = ((r"joint limit", Verdict.JOINT_LIMIT), (r"singular", Verdict.SINGULARITY))
AT_THE_GRASP = ("grasp: ", "way to the grasp: on the line, ", "")


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
        of_estimate["candidates"].append(node if refused is None else node | {"detail": refused})
    return tree


def planning_verdict(refusal: str, tool: Collection[str]) -> Verdict:
    """The verdict on a grasp that planning refused, from what it said: `reason: stage: what touches what`."""
    reason, _, detail = refusal.partition(": ")
    if reason == Verdict.NO_PLACE:
        return Verdict.NO_PLACE
    for pattern, verdict in BY_THE_ARM:
        if re.search(pattern, detail):
            return verdict
    if reason == "unreachable":
        return Verdict.NO_IK
    stage, who, what = _contact(detail)
    if who == "held" and what.startswith(f"{SOURCE}_"):
        return Verdict.HELD_BIN
    if stage in AT_THE_GRASP and who in tool:
        if what.startswith(f"{SOURCE}_"):
            return Verdict.GRIPPER_BIN
        if what == "pile":
            return Verdict.GRIPPER_HEAP
    return Verdict.PATH_BLOCKED


def verdict_counts(tree: Any) -> Counter[str]:
    """How many grasp poses of a tree, or of one of its estimates, have each verdict."""
    counts: Counter[str] = Counter()
    for estimate in [tree] if isinstance(tree, dict) else tree or ():
        for of_point in estimate.get("ruled_out", {}).values():
            counts.update(of_point)
        counts.update(c["verdict"] for c in estimate.get("candidates", ()))
    return counts


def _contact(detail: str) -> tuple[str, str, str]:
    """Stage with its colon, and the two that touch; empty where the detail names none."""
    found = re.fullmatch(r"(.*: (?:on the line, )?|)(\S+) touches (\S+)", detail)
    return ("?", "", "") if found is None else (found[1], found[2], found[3])
