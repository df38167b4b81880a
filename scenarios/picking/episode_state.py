"""What a cell remembers between the attempts of an episode."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pickproof.cell.frames import Array
from pickproof.grasping.grasp_points import GraspPoses
from pickproof.scenarios.picking.placed_heightmap import Placed
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.placing.factory import Place

AVOID_RADIUS = 0.02  # [m] around a failed estimate within which estimates are left alone


@dataclass
class EpisodeState:
    """What the cell remembers between attempts: failed spots, what was placed, and where the arm waits.

    Attributes:
        waits_at: (6,) joint vector over the place bin where the arm stands with open jaws; None at home.
        opened: of the jaws there, in [m].
        placed: what was let go over the place bin.
    """

    place: Place
    placed: Placed
    waits_at: Array | None = None
    opened: float = 0.0
    failed: list[tuple[int, Array]] = field(default_factory=list)
    _placeable: np.ndarray | None = None

    @staticmethod
    def of(cell: Workcell) -> EpisodeState:
        """Before the first pick."""
        return EpisodeState(cell.new_place(), Placed(cell.place, cell.workpiece))

    def placeable(self, grasps: GraspPoses) -> np.ndarray:
        """(n,) bool: the grasp poses of the cell from which a workpiece can be put down as wanted; worked out once."""
        if self._placeable is None:
            self._placeable = self.place.placeable(grasps.Ts_part_tool)
        return self._placeable

    def avoided(self, Ts_world_part: Array, attempt: int, span: int) -> np.ndarray:
        """(k,) bool: the estimate lies where a pick failed within the last `span` attempts.

        Every further failure at a spot doubles the time for which it is left alone: what came off twice in the same
        place will most likely do so again.
        """
        out = np.zeros(len(Ts_world_part), bool)
        for k, T in enumerate(Ts_world_part):
            failed = [at for at, p in self.failed if np.linalg.norm(T[:3, 3] - p) < AVOID_RADIUS]
            out[k] = bool(failed) and attempt - failed[-1] <= span * 2 ** (len(failed) - 1)
        return out


def waits_at(cell: Workcell, state: EpisodeState) -> Array:
    """Joint vector (6,) at which the arm stands now."""
    return cell.robot.home if state.waits_at is None else state.waits_at
