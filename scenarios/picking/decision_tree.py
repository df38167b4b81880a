"""The decision tree of an attempt: estimates -> grasp points -> the first reason that ruled each pose out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import asdict, dataclass
from typing import Any

from pickproof.grasping.candidates import GraspCandidate, Selection
from pickproof.grasping.verdict import CHOSEN, Verdict
from pickproof.robots.failure import Cause, PlanFailure, Stage
from pickproof.scenarios.picking.cell_model import SOURCE
from pickproof.scenarios.picking.stages import Considered, Decision, Evidence, RuledOut

BY_THE_ARM = {
    Cause.OUT_OF_REACH: Verdict.NO_IK,
    Cause.JOINT_LIMIT: Verdict.JOINT_LIMIT,
    Cause.SINGULARITY: Verdict.SINGULARITY,
    Cause.TORQUE: Verdict.TORQUE,
}


@dataclass(frozen=True)
class CandidateNode:
    """Result of one grasp candidate; fields that are None are left out of the JSON.

    Attributes:
        terms: of the rank. detail: why planning refused it.
        weighed: of the chosen one, the number of workpieces by the wrist sensor.
        after_stop: of the chosen one, how the arm recovered after a stop.
    """

    grasp: str
    rank: float
    terms: dict[str, float]
    verdict: str
    detail: str | None = None
    weighed: str | None = None
    after_stop: str | None = None


@dataclass(frozen=True)
class EstimateNode:
    """Results of the grasp poses of one estimate.

    Attributes:
        position: of the workpiece in the world [m].
        ruled_out: grasp point -> verdict -> number of poses.
        candidates: those that planning examined, and the best one.
    """

    score: float
    position: list[float]
    ruled_out: dict[str, dict[str, int]]
    candidates: list[CandidateNode]


def decision_tree(considered: Considered, evidence: Evidence | None, tool: Collection[str]) -> list[EstimateNode]:
    """The tree of all grasp poses of all estimates.

    Args:
        evidence: of the executed pick, None for a no-pick.
        tool: names of the gripper's boxes, to tell its collisions from the arm's.
    """
    selection, estimates = considered.selection, considered.estimates
    verdicts = candidate_verdicts(selection, considered.decision, tool)
    of_estimate: list[list[int]] = [[] for _ in estimates.scores]
    for i, candidate in enumerate(selection.candidates):
        of_estimate[candidate.estimate].append(i)
    nodes = []
    for k, (T_world_part, score) in enumerate(zip(estimates.Ts_world_part, estimates.scores, strict=True)):
        # of the outranked candidates only the best has its own entry; the others are counted
        shown = [i for n, i in enumerate(of_estimate[k]) if n == 0 or verdicts[i] != Verdict.OUTRANKED]
        outranked = Counter(selection.candidates[i].point.name for i in of_estimate[k] if i not in shown)
        nodes.append(
            EstimateNode(
                score=round(float(score), 4),
                position=[round(float(x), 4) for x in T_world_part[:3, 3]],
                ruled_out=_with_outranked(selection.ruled_out[k], outranked),
                candidates=[_candidate_node(considered, i, verdicts[i], evidence) for i in shown],
            )
        )
    return nodes


def tree_json(tree: list[EstimateNode]) -> list[dict[str, Any]]:
    """The tree as JSON, the form in which records hold it."""

    def without_none(items: list[tuple[str, Any]]) -> dict[str, Any]:
        return {name: value for name, value in items if value is not None}

    return [asdict(node, dict_factory=without_none) for node in tree]


def candidate_verdicts(selection: Selection, decision: Decision, tool: Collection[str]) -> list[str]:
    """The verdict on each ranked candidate, in their order."""
    verdicts = []
    for i, candidate in enumerate(selection.candidates):
        refused = decision.refused.get(i)
        verdict = str(Verdict.OUTRANKED if refused is None else planning_verdict(refused, tool))
        verdicts.append(CHOSEN if candidate is decision.candidate else verdict)
    return verdicts


def planning_verdict(failure: PlanFailure | RuledOut, tool: Collection[str]) -> Verdict:
    """The verdict on a grasp that was refused by planning."""
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


def rounded_terms(candidate: GraspCandidate) -> dict[str, float]:
    """Terms of the rank, rounded for the record."""
    return {name: round(value, 3) for name, value in candidate.terms.items()}


def _with_outranked(ruled_out: dict[str, dict[str, int]], outranked: Counter[str]) -> dict[str, dict[str, int]]:
    counts = {name: dict(of_grasp) for name, of_grasp in ruled_out.items()}
    for name, number in outranked.items():
        of_grasp, verdict = counts.setdefault(name, {}), str(Verdict.OUTRANKED)
        of_grasp[verdict] = of_grasp.get(verdict, 0) + number
    return counts


def _candidate_node(considered: Considered, index: int, verdict: str, evidence: Evidence | None) -> CandidateNode:
    candidate, refused = considered.selection.candidates[index], considered.decision.refused.get(index)
    weighed = after_stop = None
    if verdict == CHOSEN and evidence is not None:
        weighed = None if evidence.weighed is None else str(evidence.weighed)
        if evidence.log.stopped:
            after_stop = "set back by hand" if evidence.set_back else "drew back"
    return CandidateNode(
        grasp=candidate.point.name,
        rank=round(candidate.rank, 4),
        terms=rounded_terms(candidate),
        verdict=verdict,
        detail=None if refused is None else str(refused),
        weighed=weighed,
        after_stop=after_stop,
    )
