"""What came of an attempt, judged from physics and ground truth after the fact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.physics.observation import Snapshot
from pickproof.cell.physics.trajectory_execution import MotionLog
from pickproof.cell.symmetry.pose_error import point_distances, rotation_error
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.scenarios.picking.workcell import PLACE, SOURCE
from pickproof.scenarios.results.records import Reason

if TYPE_CHECKING:
    from pickproof.scenarios.picking.double_pick import Weighed


@dataclass(frozen=True)
class Evidence:
    """What was seen of one attempt.

    Attributes:
        before, after: the workpieces before the arm moved, and after it was home and they had time to rest.
        closed, lifted, carried: workpieces that the gripper held after closing, after the lift, and when the place
            pose was reached.
        in_tolerance: what was carried rests where it was to be let go, as closely as the scenario asks.
        put_back: what came up weighed as much as several, and was let go where it had been.
        set_back: the arm was stopped, could not draw back by itself, and was set back to home by hand.
        weighed: how many workpieces the wrist says came along; None where nothing was carried to the place.
        released: nothing was held after opening.
        log: of all motions. seconds: simulated time of the attempt.
        pose_ok: the chosen estimate is within tolerance of a workpiece.
    """

    before: Snapshot
    after: Snapshot
    closed: tuple[int, ...]
    lifted: tuple[int, ...]
    carried: tuple[int, ...]
    released: bool
    log: MotionLog
    seconds: float
    pose_ok: bool
    put_back: bool = False
    set_back: bool = False
    in_tolerance: bool = True
    weighed: Weighed | None = None


def judge(evidence: Evidence, force_limit: float, time_limit: float) -> Reason | Literal[""]:
    """The reason why an attempt failed, empty for a success (definitions in docs/scenarios.md).

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
