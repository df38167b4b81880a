"""From ranked candidates to one with a whole motion, or the reason why the arm does not move."""

from __future__ import annotations

from collections import Counter

from cell.camera import DepthFrame
from grasping.candidates import GraspCandidate, Selection
from grasping.verdict import Verdict
from robots.failure import PlanFailure, Stage
from robots.plan import PickPlan
from scenarios.memory import Memory
from scenarios.planners import ArmPlanner, FreePlanner
from scenarios.records import Reason
from scenarios.rehearsal import REHEARSALS
from scenarios.stages import Decision, RuledOut
from scenarios.workcell import Workcell

PLANS_TRIED = 60
"""Candidates for which a whole motion is planned before giving up."""
PLANS_ELSEWHERE = 8
"""Of those that could be gripped, but not brought to any place offered: planned again to each further set of places."""
PLANS_A_ROUND = 4
"""Plans for one workpiece before the others get their turn: where the arm cannot go, the next grasp rarely helps."""


def decide(cell: Workcell, frame: DepthFrame, selection: Selection, memory: Memory, seed: int) -> Decision:
    """The first candidate, best rank first, for which there is a whole motion to a free place."""
    if not selection.ruled_out:
        return Decision(None, None, Reason.NO_DETECTION, {})
    if not selection.candidates:
        return Decision(None, None, Reason.ALL_GRASPS_BLOCKED, {})
    planner = FreePlanner(cell, frame, memory) if "motion" in cell.oracle else ArmPlanner(cell, frame, memory, seed)
    order = in_rounds(selection.candidates)
    decision = _first_plan(cell, planner, selection, order, memory, {})
    for _ in range(memory.place.rounds - 1):
        again = [i for i in order if stopped_at_place(decision.refused.get(i))][:PLANS_ELSEWHERE]
        if decision.plan is not None or not again:
            break
        memory.place.pass_over()
        decision = _first_plan(cell, planner, selection, again, memory, decision.refused)
    return decision


def stopped_at_place(refused: PlanFailure | RuledOut | None) -> bool:
    """The grasp can be reached; what is refused is every way to the places that were offered."""
    return isinstance(refused, PlanFailure) and refused.stage >= Stage.PLACE


def _first_plan(
    cell: Workcell,
    planner: ArmPlanner | FreePlanner,
    selection: Selection,
    order: list[int],
    memory: Memory,
    refused: dict[int, PlanFailure | RuledOut],
) -> Decision:
    """The first candidate of those in `order` with a plan to the places offered now; `refused` is added to."""
    reason = Reason.NO_PLACE
    rehearsed: list[tuple[int, PickPlan]] = []
    first = planner.planned
    for i in order:
        candidate = selection.candidates[i]
        if not memory.place.placeable(candidate.T_part_tool[None])[0]:
            refused[i] = RuledOut(Verdict.NO_PLACE, "held so it cannot be put down as wanted")
            continue
        plan = planner(candidate)
        if isinstance(plan, PickPlan):
            fault = "" if cell.rehearsal is None else cell.rehearsal.refuses(candidate, cell.observe())
            if not fault:
                refused.pop(i, None)
                return Decision(candidate, plan, "", refused)
            rehearsed.append((i, plan))
            refused[i] = RuledOut(Verdict.REHEARSAL, fault)
        else:
            refused[i] = plan
            reason = Reason.NO_PATH if Reason.NO_PATH in (reason, plan.reason) else Reason.UNREACHABLE
        if planner.planned - first >= PLANS_TRIED or len(rehearsed) >= REHEARSALS:
            break
    if rehearsed:  # the grasp oracle chooses among grasps; it does not decide whether to pick
        best, plan = rehearsed[0]
        del refused[best]
        return Decision(selection.candidates[best], plan, "", refused)
    return Decision(None, None, reason, refused)


def in_rounds(candidates: list[GraspCandidate]) -> list[int]:
    """Indices of the candidates, best first, PLANS_A_ROUND of every estimate before the next ones of any."""
    seen: Counter[int] = Counter()
    rounds = []
    for candidate in candidates:
        rounds.append(seen[candidate.estimate] // PLANS_A_ROUND)
        seen[candidate.estimate] += 1
    return sorted(range(len(candidates)), key=lambda i: rounds[i])  # stable: rank decides within a round
