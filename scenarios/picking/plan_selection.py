"""Choice of the first ranked candidate with a whole motion, or the reason why the arm does not move."""

from __future__ import annotations

from collections import Counter

from pickproof.cell.sensing.camera import DepthFrame
from pickproof.grasping.candidates import GraspCandidate, Selection
from pickproof.grasping.verdict import Verdict
from pickproof.robots.failure import PlanFailure
from pickproof.robots.plan.pick_plan import PickPlan
from pickproof.scenarios.picking.carriers import Planner
from pickproof.scenarios.picking.episode_state import EpisodeState, stopped_at_place
from pickproof.scenarios.picking.grasp_oracle import TRIALS
from pickproof.scenarios.picking.stages import Decision, PlannedPick, RuledOut
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.results.records import Reason

PLANS_TRIED = 60
"""Largest number of candidates for which a whole motion is planned."""
PLANS_ELSEWHERE = 8
"""Candidates that can be gripped but not placed at the tried places: planned again to each further set of places."""
PLANS_A_ROUND = 4
"""Plans for one workpiece before other workpieces follow: after a failure, its next grasp rarely succeeds."""


def decide(cell: Workcell, frame: DepthFrame, selection: Selection, state: EpisodeState, seed: int) -> Decision:
    """The first candidate, best rank first, for which there is a whole motion to a free place."""
    if not selection.ruled_out:
        return Decision(None, Reason.NO_DETECTION, {})
    if not selection.candidates:
        return Decision(None, Reason.ALL_GRASPS_BLOCKED, {})
    order = in_rounds(selection.candidates)
    search = _PlanSearch(cell, state, selection, cell.carrier.planner(cell, frame, state, seed))
    decision = search.first_plan(order)
    for _ in range(state.place.rounds - 1):
        again = [i for i in order if stopped_at_place(search.refused.get(i))][:PLANS_ELSEWHERE]
        if decision.pick is not None or not again:
            break
        state.place.pass_over()
        decision = search.first_plan(again)
    return decision


class _PlanSearch:
    """Plans candidates of one selection, and remembers why each was refused last."""

    def __init__(self, cell: Workcell, state: EpisodeState, selection: Selection, planner: Planner) -> None:
        self._cell, self._state, self._planner = cell, state, planner
        self._candidates = selection.candidates
        self.refused: dict[int, PlanFailure | RuledOut] = {}

    def first_plan(self, order: list[int]) -> Decision:
        """The first candidate of those in `order` with a plan to the places that come first now."""
        reason, first = Reason.NO_PLACE, self._planner.planned
        doubted: list[tuple[int, PlannedPick]] = []
        for i in order:
            found = self._plan(self._candidates[i])
            if isinstance(found, PlannedPick):
                fault = self._cell.heap.refuses(found.candidate)
                if not fault:
                    return self._take(i, found)
                doubted.append((i, found))
                self.refused[i] = RuledOut(Verdict.TRIAL, fault)
            else:
                self.refused[i] = found
                reason = _worst(reason, found)
            if self._planner.planned - first >= PLANS_TRIED or len(doubted) >= TRIALS:
                break
        if doubted:  # the grasp oracle chooses among grasps; it does not decide whether to pick
            return self._take(*doubted[0])
        return Decision(None, reason, self.refused)

    def _plan(self, candidate: GraspCandidate) -> PlannedPick | PlanFailure | RuledOut:
        if not self._state.place.placeable(candidate.T_part_tool[None])[0]:
            return RuledOut(Verdict.NO_PLACE, "it cannot be placed as required from this grasp")
        plan = self._planner(candidate)
        return PlannedPick(candidate, plan) if isinstance(plan, PickPlan) else plan

    def _take(self, index: int, pick: PlannedPick) -> Decision:
        self.refused.pop(index, None)
        return Decision(pick, "", self.refused)


def _worst(reason: Reason, refused: PlanFailure | RuledOut) -> Reason:
    """The reason of a no-pick after one more refusal: a blocked path says more than a pose out of reach."""
    if isinstance(refused, RuledOut):
        return reason
    return Reason.NO_PATH if Reason.NO_PATH in (reason, refused.reason) else Reason.UNREACHABLE


def in_rounds(candidates: list[GraspCandidate]) -> list[int]:
    """Indices of the candidates, best first, PLANS_A_ROUND of every estimate before the next ones of any."""
    seen: Counter[int] = Counter()
    rounds = []
    for candidate in candidates:
        rounds.append(seen[candidate.estimate] // PLANS_A_ROUND)
        seen[candidate.estimate] += 1
    return sorted(range(len(candidates)), key=lambda i: rounds[i])  # stable: rank decides within a round
