"""What the stages of a pick hand on: estimates, and the decision with what was ruled out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pickproof.cell.frames import Array
from pickproof.grasping.candidates import GraspCandidate
from pickproof.grasping.verdict import Verdict
from pickproof.robots.failure import PlanFailure
from pickproof.robots.plan.pick_plan import PickPlan
from pickproof.scenarios.results.records import Reason


@dataclass(frozen=True)
class Estimates:
    """What perception hands to grasping, best first.

    Attributes:
        Ts_world_part: (k, 4, 4).
        scores: (k,) in [0, 1].
        residuals: (k,) root mean square distance of the measured surface to the CAD in [m].
    """

    Ts_world_part: Array
    scores: Array
    residuals: Array


@dataclass(frozen=True)
class RuledOut:
    """A grasp that was ruled out for another reason than its motion, and why."""

    verdict: Verdict
    why: str

    def __str__(self) -> str:
        return f"{self.verdict}: {self.why}"


@dataclass(frozen=True)
class Decision:
    """What to do: a candidate with its plan, or the reason why the arm does not move.

    Attributes:
        refused: index of a candidate in the selection -> why it was ruled out when its turn came.
    """

    candidate: GraspCandidate | None
    plan: PickPlan | None
    reason: Reason | Literal[""]
    refused: dict[int, PlanFailure | RuledOut]
