"""Choice of the place pose: the first that can be reached with the part and left without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pickproof.cell.frames import Array, invert
from pickproof.robots.collision.scene import CollisionScene
from pickproof.robots.failure import Cause, PlanFailure, Refusal, Stage
from pickproof.robots.kinematics.inverse import Branches, inverse
from pickproof.robots.motion.stop import Stop
from pickproof.robots.motion.timing import rest_to_rest
from pickproof.robots.motion.trajectory import Trajectory
from pickproof.robots.plan.free_motion import Joined, join
from pickproof.robots.plan.pick_request import PickRequest
from pickproof.robots.plan.pick_stops import UP, stop_with_line
from pickproof.robots.plan.standing import standing

PLACES_TRIED = 12  # place poses without a blended motion after which the search for blended motions ends
EARLY = 3  # the same for consecutive early collisions: the end of the motion hardly matters then
SEARCHED_PLACES = 2  # place poses for which a path is searched when none is reached by a blended motion


def choose_place(
    scene: CollisionScene, request: PickRequest, grasp: Stop, slot: int
) -> tuple[int, Joined, Joined] | PlanFailure:
    """The first place pose that can be reached with the part and left without it; simple motions first, then a
    search.
    """
    poses = request.places.Ts_base_tool @ invert(request.hand.T_flange_tool)
    found = inverse(scene.robot, poses, grasp.q)
    if len(poses) == 0:
        return PlanFailure(Stage.PLACE, Refusal(Cause.NO_PLACE), "place")
    blocked: list[PlanFailure] = []
    unseen: list[tuple[int, Stop]] = []
    early = 0
    for k in _in_order(scene, request, found, slot, grasp.q):
        if len(unseen) >= PLACES_TRIED or early >= EARLY:
            break
        stop = standing(scene, found, k, slot, "transit")
        if stop is not None:
            blocked.append(replace(stop, stage=Stage.PLACE, where=f"place pose {k}"))
            continue
        q = found.q[k, slot]
        rise = request.lines.place * UP
        what = f"line to place pose {k}"
        place = stop_with_line(scene, request, poses[k], q, rise, "transit", Stage.PLACE_LINE, what)
        if isinstance(place, PlanFailure):
            blocked.append(place)
            continue
        if request.q_end is None and place.line is not None and isinstance(place.line.path, Refusal):
            # a gripper that descends straight only for the last part could not leave: it would hit the released part
            blocked.append(PlanFailure(Stage.PLACE_LINE, place.line.path, what))
            continue
        done = _carry(scene, request, grasp, place, None, k)
        if not isinstance(done, PlanFailure):
            return k, *done
        blocked.append(done)
        if done.stage == Stage.CARRY:
            unseen.append((k, place))
            early = early + 1 if done.refusal.early else 0
    for k, place in unseen[: SEARCHED_PLACES if request.search.allowed else 0]:
        done = _carry(scene, request, grasp, place, request.search.seed, k)
        if not isinstance(done, PlanFailure):
            return k, *done
        blocked.append(done)
    return max(blocked, key=lambda s: (s.stage, s.cause, s.refusal.contact is not None))


def _in_order(scene: CollisionScene, request: PickRequest, found: Branches, slot: int, q_grasp: Array) -> list[int]:
    """Indices of the place poses, preferred first; among equals, the fastest to reach first."""
    n = len(found.q)
    if request.places.rank is None:
        return list(range(n))
    far = np.where(found.exists[:, slot], rest_to_rest(scene.robot, found.q[:, slot] - q_grasp), np.inf)
    return sorted(range(n), key=lambda k: ((request.places.rank or ())[k], far[k]))


def _carry(
    scene: CollisionScene, request: PickRequest, grasp: Stop, place: Stop, seed: int | None, k: int
) -> tuple[Joined, Joined] | PlanFailure:
    """Motion with the part to a place pose, and without it back home if requested."""
    carry = join(scene, grasp, place, request.slow, seed, "carry")
    if isinstance(carry, Refusal):
        return PlanFailure(Stage.CARRY, carry, f"way to place pose {k}")
    if request.q_end is None:
        return carry, (Trajectory("leave", place.q[None].copy(), np.zeros((1, 6)), request.limits.dt), "direct")
    with scene.empty_handed():
        leave = join(scene, place, Stop(request.q_end), request.free, request.search.seed, "leave")
    if isinstance(leave, Refusal):
        return PlanFailure(Stage.LEAVE, leave, f"way home from place pose {k}")
    return carry, leave
