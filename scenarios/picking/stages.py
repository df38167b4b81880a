"""Frozen results that the stages of a pick pass on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from pickproof.cell.frames import Array
from pickproof.cell.physics.observation import Snapshot
from pickproof.cell.physics.trajectory_execution import MotionLog
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.grasping.candidates import GraspCandidate, Selection
from pickproof.grasping.verdict import Verdict
from pickproof.robots.failure import PlanFailure
from pickproof.robots.plan.pick_plan import PickPlan
from pickproof.scenarios.results.records import Reason


@dataclass(frozen=True)
class Estimates:
    """Estimates of perception, best first.

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
    """A grasp that was ruled out for a reason other than its motion, and the reason."""

    verdict: Verdict
    why: str

    def __str__(self) -> str:
        return f"{self.verdict}: {self.why}"


@dataclass(frozen=True)
class PlannedPick:
    """A grasp with its whole motion, ready to be executed."""

    candidate: GraspCandidate
    plan: PickPlan


@dataclass(frozen=True)
class Decision:
    """The decision: a planned pick, or the reason why the arm does not move.

    Attributes:
        pick: None for a no-pick.
        reason: of a no-pick, else empty.
        refused: index of a candidate in the selection -> why planning ruled it out.
    """

    pick: PlannedPick | None
    reason: Reason | Literal[""]
    refused: Mapping[int, PlanFailure | RuledOut]

    @property
    def candidate(self) -> GraspCandidate | None:
        """The chosen grasp, None for a no-pick."""
        return None if self.pick is None else self.pick.candidate

    @property
    def plan(self) -> PickPlan | None:
        """Its motion, None for a no-pick."""
        return None if self.pick is None else self.pick.plan


@dataclass(frozen=True)
class ComputeTimes:
    """Measured compute time in [s] of the stages before the motion."""

    perceive_s: float
    choose_s: float
    plan_s: float


@dataclass(frozen=True)
class Considered:
    """All data and decisions before the arm moves.

    Attributes:
        before: ground truth when the image was taken, for scoring.
    """

    before: Snapshot
    frame: DepthFrame
    estimates: Estimates
    selection: Selection
    decision: Decision
    times: ComputeTimes


class Weighed(StrEnum):
    """Number of held workpieces by the wrist's force sensor."""

    ONE = "one"
    SEVERAL = "several"
    CANNOT_TELL = "cannot tell"


@dataclass(frozen=True)
class Evidence:
    """Observations in the physics during one executed pick.

    Attributes:
        before, after: the workpieces before the arm moved, and after it stopped and they had time to rest.
        closed, lifted, carried: workpieces that the gripper held after closing, after the lift, and when the place
            pose was reached.
        released: nothing was held after opening.
        log: of all motions. seconds: simulated time of the attempt.
        pose_ok: the chosen estimate is within tolerance of a workpiece.
        put_back: the load weighed as much as several workpieces and was released where it was taken.
        set_back: the arm was stopped, could not retreat by itself, and was reset to home.
        in_tolerance: the carried workpiece rests within the scenario's tolerance of its release pose.
        weighed: number of workpieces by the wrist sensor; None where nothing was carried to the place.
    """

    before: Snapshot
    after: Snapshot
    closed: tuple[int, ...]
    lifted: tuple[int, ...]
    carried: tuple[int, ...]
    released: bool
    log: MotionLog
    seconds: float
    pose_ok: bool = True
    put_back: bool = False
    set_back: bool = False
    in_tolerance: bool = True
    weighed: Weighed | None = None


@dataclass(frozen=True)
class ExecutedPick:
    """An executed pick: its targets and the observations.

    Attributes:
        T_world_estimate: (4, 4) estimated pose of the target workpiece.
        T_world_release: (4, 4) its planned release pose.
    """

    pick: PlannedPick
    T_world_estimate: Array
    T_world_release: Array
    evidence: Evidence
