"""Whether the arm can be at a TCP pose: in reach, within joint limits, away from singularities, collision-free."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pickproof.cell.frames import Array, invert
from pickproof.robots.collision.checker import Mode
from pickproof.robots.collision.scene import CollisionScene
from pickproof.robots.failure import Cause, PlanFailure, Refusal, Stage
from pickproof.robots.kinematics.inverse import FRONT, SIGMA_MIN, Branches, inverse


def check_grasps(scene: CollisionScene, Ts_base_tool: Array, T_flange_tool: Array) -> Iterator[PlanFailure | None]:
    """For each TCP grasp pose (n, 4, 4) in turn: None where the arm can be there without collision, or the reason.

    The inverse kinematics of all poses is computed at the first step, each collision check on demand: stop the
        iteration when enough are found.
    """
    found = inverse(scene.robot, np.asarray(Ts_base_tool) @ invert(T_flange_tool))
    for k in range(len(found.q)):
        stops: list[PlanFailure] = []
        for slot in FRONT:
            stop = standing(scene, found, k, slot, "contact")
            if stop is None:
                break
            stops.append(stop)
        if len(stops) < len(FRONT):
            yield None
        else:
            yield first_failure(stops)


def first_failure(stops: list[PlanFailure]) -> PlanFailure:
    """The reason of the first branch within the joint limits, if there is one."""
    near = [(s.stage, s.cause) for s in stops]
    told = next((s for s, n in zip(stops, near, strict=True) if n > (Stage.GRASP, Cause.JOINT_LIMIT)), None)
    return told or stops[near.index(max(near))]


def standing(scene: CollisionScene, found: Branches, k: int, slot: int, mode: Mode) -> PlanFailure | None:
    """Why the arm cannot be at pose k in a branch: a limit of the arm, or a collision."""
    robot, q = scene.robot, found.q[k, slot]
    if not found.exists[k, slot]:
        refusal = Refusal(Cause.OUT_OF_REACH)
    elif not found.valid[k, slot]:
        refusal = Refusal(Cause.JOINT_LIMIT, joint=int(np.argmax((q < robot.lower) | (q > robot.upper))) + 1)
    elif found.sigma[k, slot] <= SIGMA_MIN:
        refusal = Refusal(Cause.SINGULARITY)
    else:
        contact = scene.first_contact(q, mode)
        if contact is None:
            return None
        refusal = Refusal(Cause.COLLISION, contact=contact)
    return PlanFailure(Stage.GRASP, refusal, "grasp")
