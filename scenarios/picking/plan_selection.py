"""From ranked candidates to one with a whole motion, or the reason why the arm does not move."""

from __future__ import annotations

from collections import Counter

from pickproof.cell.sensing.camera import DepthFrame
from pickproof.grasping.candidates import GraspCandidate, Selection
from pickproof.grasping.verdict import Verdict
from pickproof.robots.failure import PlanFailure, Stage
from pickproof.robots.plan.pick_plan import PickPlan
from pickproof.scenarios.picking.arm_planner import ArmPlanner, FreePlanner
from pickproof.scenarios.picking.episode_state import EpisodeState
from pickproof.scenarios.picking.grasp_oracle import TRIALS
from pickproof.scenarios.picking.stages import Decision, RuledOut
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.results.records import Reason

PLANS_TRIED = 60
"""Candidates for which a whole motion is planned before giving up."""
PLANS_ELSEWHERE = 8
"""Of those that could be gripped, but not brought to any place offered: planned again to each further set of places."""
PLANS_A_ROUND = 4
"""Plans for one workpiece before the others get their turn: where the arm cannot go, the next grasp rarely helps."""


def decide(cell: Workcell, frame: DepthFrame, selection: Selection, state: EpisodeState, seed: int) -> Decision:
    """The first candidate, best rank first, for which there is a whole motion to a free place."""
    if not selection.ruled_out:
        return Decision(None, None, Reason.NO_DETECTION, {})
    if not selection.candidates:
        return Decision(None, None, Reason.ALL_GRASPS_BLOCKED, {})
    planner = FreePlanner(cell, frame, state) if "motion" in cell.oracle else ArmPlanner(cell, frame, state, seed)
    order = in_rounds(selection.candidates)
    decision = _first_plan(cell, planner, selection, order, state, {})
    for _ in range(state.place.rounds - 1):
        again = [i for i in order if stopped_at_place(decision.refused.get(i))][:PLANS_ELSEWHERE]
        if decision.plan is not None or not again:
            break
        state.place.pass_over()
        decision = _first_plan(cell, planner, selection, again, state, decision.refused)
    return decision


def stopped_at_place(refused: PlanFailure | RuledOut | None) -> bool:
    """The grasp can be reached; what is refused is every way to the places that were offered."""
    return isinstance(refused, PlanFailure) and refused.stage >= Stage.PLACE


def _first_plan(
    cell: Workcell,
    planner: ArmPlanner | FreePlanner,
    selection: Selection,
    order: list[int],
    state: EpisodeState,
    refused: dict[int, PlanFailure | RuledOut],
) -> Decision:
    """The first candidate of those in `order` with a plan to the places offered now; `refused` is added to."""
    reason = Reason.NO_PLACE
    held: list[tuple[int, PickPlan]] = []
    first = planner.planned
    for i in order:
        candidate = selection.candidates[i]
        if not state.place.placeable(candidate.T_part_tool[None])[0]:
            refused[i] = RuledOut(Verdict.NO_PLACE, "held so it cannot be put down as wanted")
            continue
        plan = planner(candidate)
        if isinstance(plan, PickPlan):
            fault = "" if cell.grasp_oracle is None else cell.grasp_oracle.refuses(candidate, cell.observe())
            if not fault:
                refused.pop(i, None)
                return Decision(candidate, plan, "", refused)
            held.append((i, plan))
            refused[i] = RuledOut(Verdict.REHEARSAL, fault)
        else:
            refused[i] = plan
            reason = Reason.NO_PATH if Reason.NO_PATH in (reason, plan.reason) else Reason.UNREACHABLE
        if planner.planned - first >= PLANS_TRIED or len(held) >= TRIALS:
            break
    if held:  # the grasp oracle chooses among grasps; it does not decide whether to pick
        best, plan = held[0]
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
