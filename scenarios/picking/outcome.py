"""The definition of success and of every failure: an attempt judged from physics and ground truth after the fact.

`judge` is the definition; docs/reference/definitions.md says it in words. It reads `Evidence` (`stages.py`), which
`execution.py` collects. Its limits are the scenario's field `limits`; `Place.accepts` has the tolerance of the place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.physics.observation import Snapshot
from pickproof.cell.symmetry.pose_error import point_distances, rotation_error
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.scenarios.picking.cell_model import PLACE, SOURCE, CellModel
from pickproof.scenarios.picking.stages import Evidence, ExecutedPick
from pickproof.scenarios.placing.factory import Place
from pickproof.scenarios.placing.heap_placing import place_error
from pickproof.scenarios.results.records import Reason


@dataclass(frozen=True)
class PoseError:
    """Distance of a pose from the wanted one: `metres`, and `radians` with the symmetry of the workpiece considered."""

    metres: float
    radians: float


@dataclass(frozen=True)
class Outcome:
    """Outcome of an attempt.

    Attributes:
        reason: why it failed or the arm did not move; empty for a success.
        after: the workpieces at its end.
        evidence: of the executed pick, None for a no-pick.
        pose_error: of the chosen estimate against the nearest workpiece, None for a no-pick.
        place_error: of a workpiece carried to the place bin against its planned release pose, horizontally and in
            rotation; else None.
    """

    reason: Reason | Literal[""]
    after: Snapshot
    evidence: Evidence | None = None
    pose_error: PoseError | None = None
    place_error: PoseError | None = None

    @property
    def success(self) -> bool:
        """Whether the pick is a success."""
        return self.reason == ""


def judge_pick(cell: CellModel, place: Place, executed: ExecutedPick) -> Outcome:
    """Hold an executed pick against ground truth; `place` says how closely it must rest to where it was let go."""
    e, placed = executed.evidence, None
    _, *error = nearest_true(executed.T_world_estimate, e.before.Ts_world_part, cell.workpiece)
    pose_error = PoseError(*error)
    if set(e.carried) & set(e.after.parts_in(PLACE)):
        rests = e.after.Ts_world_part[e.carried[0]]
        placed = PoseError(*place_error(rests, executed.T_world_release, cell.workpiece))
    evidence = replace(
        e,
        pose_ok=pose_error.metres < cell.workpiece.tolerance,
        in_tolerance=placed is None or place.accepts(placed.metres, placed.radians),
    )
    limits = cell.scenario.limits
    reason = judge(evidence, limits.contact_force_N, limits.attempt_timeout_s)
    return Outcome(reason, e.after, evidence, pose_error, placed)


def judge(evidence: Evidence, force_limit: float, time_limit: float) -> Reason | Literal[""]:
    """The reason why an attempt failed, empty for a success (definitions in docs/reference/definitions.md).

    Args:
        force_limit: [N] hardest allowed touch of arm or gripper body. time_limit: [s].
    """
    reason = _what_happened(evidence, force_limit, time_limit)
    blamed_on_pose = (Reason.MISSED, Reason.SLIPPED, Reason.DROPPED, Reason.COLLISION, Reason.DOUBLE_PICK)
    if reason in blamed_on_pose and not evidence.pose_ok:
        return Reason.WRONG_POSE
    return reason


def _what_happened(e: Evidence, force_limit: float, time_limit: float) -> Reason | Literal[""]:
    if e.log.max_force > force_limit or e.log.stopped:
        return Reason.COLLISION
    if e.seconds > time_limit:
        return Reason.TIMEOUT
    left = set(e.after.left(e.before, SOURCE))
    lost_placed = e.after.left(e.before, PLACE)
    held = set(e.carried or e.lifted or e.closed)  # as late as anything was held
    if len(e.lifted) > 1 or len(e.carried) > 1 or len(left & set(e.after.parts_in(PLACE))) > 1:
        return Reason.DOUBLE_PICK
    if lost_placed or left - held:
        return Reason.EJECTED
    if e.put_back:
        return Reason.DOUBLE_PICK
    if not e.closed:
        return Reason.MISSED
    if not e.lifted:
        return Reason.SLIPPED
    if not e.carried:
        return Reason.DROPPED
    (part,) = e.carried
    placed = part in e.after.parts_in(PLACE) and bool(e.after.at_rest[part]) and part not in e.after.on_rim
    placed = placed and e.released and e.in_tolerance
    return "" if placed and left == {part} else Reason.MISPLACED


def nearest_true(T_world_part: Array, truth: Array, workpiece: Workpiece) -> tuple[int, float, float]:
    """Index of the workpiece nearest to an estimate, and the estimate's error in [m] and [rad].

    The error in [m] is the mean distance of CAD points (PS6D, eq. D_i), symmetry considered. Raises ValueError when
    there is no workpiece.
    """
    points = workpiece.sample_surface(300, seed=2)[0]
    distance = point_distances(truth, np.broadcast_to(T_world_part, truth.shape), points, workpiece.symmetry).mean(-1)
    best = int(np.argmin(distance))
    angle = rotation_error(truth[best, :3, :3], T_world_part[:3, :3], workpiece.symmetry)
    return best, float(distance[best]), angle
