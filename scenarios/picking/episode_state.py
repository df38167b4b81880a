"""State of a cell between the attempts of an episode."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.physics.arm import Arm
from pickproof.grasping.grasp_points import GraspPoses
from pickproof.robots.failure import PlanFailure, Stage
from pickproof.scenarios.picking.cell_model import CellModel
from pickproof.scenarios.picking.placed_heightmap import Placed
from pickproof.scenarios.picking.stages import Decision, ExecutedPick, RuledOut
from pickproof.scenarios.placing.factory import Place

AVOID_RADIUS = 0.02  # [m] around a failed estimate within which estimates are avoided


@dataclass
class EpisodeState:
    """State between attempts: failed positions, placed workpieces, and the waiting pose of the arm.

    Attributes:
        place: which places are taken.
        placed: surfaces of what was let go over the place bin.
        waits_at: (6,) joint vector over the place bin where the arm stands with open jaws; None at home.
        opened: of the jaws there, in [m].
        failed: attempt and position (3,) [m] of each estimate on which a pick failed.
    """

    place: Place
    placed: Placed
    waits_at: Array | None = None
    opened: float = 0.0
    failed: list[tuple[int, Array]] = field(default_factory=list)
    _placeable: np.ndarray | None = None

    @staticmethod
    def of(cell: CellModel) -> EpisodeState:
        """The state before the first pick."""
        return EpisodeState(cell.new_place(), Placed(cell.place, cell.workpiece))

    def placeable(self, grasps: GraspPoses) -> np.ndarray:
        """(n,) bool: the grasp poses of the cell from which a workpiece can be placed as required; computed once."""
        if self._placeable is None:
            self._placeable = self.place.placeable(grasps.Ts_part_tool)
        return self._placeable

    def avoided(self, Ts_world_part: Array, attempt: int, span: int) -> np.ndarray:
        """(k,) bool: the estimate lies where a pick failed within the last `span` attempts.

        Every further failure at a position doubles the time for which it is avoided, because it will probably fail
        again.
        """
        out = np.zeros(len(Ts_world_part), bool)
        for k, T in enumerate(Ts_world_part):
            failed = [at for at, p in self.failed if np.linalg.norm(T[:3, 3] - p) < AVOID_RADIUS]
            out[k] = bool(failed) and attempt - failed[-1] <= span * 2 ** (len(failed) - 1)
        return out

    def remember_no_pick(self, decision: Decision) -> None:
        """Update after a no-pick: next time other places come first if the last ones could not be reached."""
        if any(stopped_at_place(failure) for failure in decision.refused.values()):
            self.place.pass_over()

    def remember_pick(self, attempt: int, executed: ExecutedPick, arm: Arm) -> None:
        """Update after a pick, from signals of gripper and arm only; the outcome is ground truth and is not used."""
        self._remember_arm(executed, arm)
        evidence = executed.evidence
        lost = bool(evidence.lifted) and not (evidence.carried or evidence.put_back or evidence.log.stopped)
        if evidence.carried or lost:  # a workpiece lost in the transfer may lie there: the place is not used again
            self.placed.add(executed.T_world_release, self.place.fall)
            self.place.fill(executed.pick.plan.place)
        if not evidence.carried:
            self.failed.append((attempt, executed.T_world_estimate[:3, 3]))

    def _remember_arm(self, executed: ExecutedPick, arm: Arm) -> None:
        """Set the waiting pose of the arm and the opening of its jaws."""
        evidence = executed.evidence
        if evidence.set_back:
            self.waits_at = None
        elif evidence.closed and not evidence.put_back and not evidence.log.stopped:
            self.waits_at = executed.pick.plan.carry.q[-1]
        elif self.waits_at is not None:
            self.waits_at = arm.q  # over the last place, on the path of its arrival
        self.opened = arm.opening


def waits_at(cell: CellModel, state: EpisodeState) -> Array:
    """Current joint vector (6,) of the robot."""
    return cell.robot.home if state.waits_at is None else state.waits_at


def stopped_at_place(refused: PlanFailure | RuledOut | None) -> bool:
    """Whether the grasp can be reached and only the motions to the tried places were refused."""
    return isinstance(refused, PlanFailure) and refused.stage >= Stage.PLACE
