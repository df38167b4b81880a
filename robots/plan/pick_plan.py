"""The motion of one pick: to the part, out of the bin, to a free place, and optionally away from it.

The arm stops only where the process requires it:
    approach  q_start -> (straight up, out of the last place) -> free motion -> straight line to the grasp
    lift      straight line out of the pile, part held, and on in a blended motion
    carry     -> straight line down to a place pose
    leave     straight line up -> q_end, where one is given; else the arm waits at the place, its jaws open
Between grasp and place the arm stays in one front-facing branch, so the wrist never flips with a held part. Every
trajectory is checked for collisions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickproof.cell.frames import Array, invert
from pickproof.robots.collision.scene import CollisionScene
from pickproof.robots.failure import Cause, PlanFailure, Refusal, Stage
from pickproof.robots.kinematics.inverse import FRONT, Branches, inverse
from pickproof.robots.motion.stop import first_beyond
from pickproof.robots.motion.timing import rest_to_rest
from pickproof.robots.motion.trajectory import Trajectory
from pickproof.robots.plan.free_motion import join
from pickproof.robots.plan.path_search import Method
from pickproof.robots.plan.pick_request import PickRequest
from pickproof.robots.plan.pick_stops import lift_stop, start_stop, stop_with_line
from pickproof.robots.plan.place_choice import choose_place
from pickproof.robots.plan.standing import check_grasps, first_failure, standing


@dataclass(frozen=True, eq=False)
class PickPlan:
    """The trajectories of a pick in order, and how they were found.

    Attributes:
        lift: ends in a blended motion, at the height of the whole line; carry goes on from there without a stop.
        leave: a single joint vector if the arm waits at the place.
        place: index of the place pose used; branch: of grasp and place; sigma: of the grasp.
        methods: how the free moves of approach, carry and leave were found.
        cleared: number of samples of `approach` before the gripper has left the last place; the jaws do not move until
            then.
    """

    approach: Trajectory
    lift: Trajectory
    carry: Trajectory
    leave: Trajectory
    place: int
    branch: int
    sigma: float
    methods: tuple[Method, Method, Method]
    cleared: int = 0

    @property
    def trajectories(self) -> tuple[Trajectory, Trajectory, Trajectory, Trajectory]:
        """The four motions in order of time."""
        return self.approach, self.lift, self.carry, self.leave

    @property
    def duration(self) -> float:
        """Robot time in [s], without opening and closing the gripper."""
        return sum(t.duration for t in self.trajectories)


def plan_pick(scene: CollisionScene, request: PickRequest) -> PickPlan | PlanFailure:
    """Plan one pick. The same scene and request give the same plan, bit for bit.

    The branch that is faster to reach is tried first; the returned failure is that of the first branch in which the
    grasp exists. The scene holds no part afterwards.
    """
    grasp = request.T_base_tool_grasp @ invert(request.hand.T_flange_tool)
    found = inverse(scene.robot, grasp[None], request.q_start)
    far = np.where(found.exists[0], rest_to_rest(scene.robot, found.q[0] - request.q_start), np.inf)
    stops = []
    for slot in sorted(FRONT, key=lambda b: far[b]):
        scene.release()
        plan = _plan_in_branch(scene, request, grasp, found, slot)
        scene.release()
        if isinstance(plan, PickPlan):
            return plan
        stops.append(plan)
    return first_failure(stops)


def _plan_in_branch(
    scene: CollisionScene, request: PickRequest, grasp: Array, found: Branches, slot: int
) -> PickPlan | PlanFailure:
    """The pick in one branch, or the failure."""
    blocked = standing(scene, found, 0, slot, "contact")
    if blocked is not None:
        return blocked
    q_grasp = found.q[0, slot]

    back, what = request.way_back, "approach line"
    out = stop_with_line(scene, request, grasp, q_grasp, back, "contact", Stage.APPROACH_LINE, what)
    if isinstance(out, PlanFailure):
        return out
    up = lift_stop(scene, request, grasp, q_grasp)
    if isinstance(up, PlanFailure):
        return up
    start = start_stop(scene, request)
    if isinstance(start, PlanFailure):
        return start
    approach = join(scene, start, out, request.free, request.search.seed, "approach", request.search.allowed)
    if isinstance(approach, Refusal):
        return PlanFailure(Stage.APPROACH, approach, "way to the grasp")
    q, away = approach[0].q, request.lines.depart
    cleared = first_beyond(scene.robot, q, request.hand.T_flange_tool, away) if away else 0
    narrow = cleared + int(np.ceil(request.hand.narrowing / request.limits.dt))
    contact = scene.path_contact(q[cleared : narrow + 1], "leave") if request.hand.narrowing else None
    # with an intermediate stop, the jaws may collide before they have closed to the approach opening
    if contact is not None:
        return PlanFailure(Stage.APPROACH, Refusal(Cause.COLLISION, contact=contact), "way to the grasp")
    scene.hold(
        request.part.held.seen_from(request.hand.T_flange_tool), request.part.tolerance, request.part.pile_without
    )
    placed = choose_place(scene, request, up, slot)
    if isinstance(placed, PlanFailure):
        return placed
    k, carry, leave = placed
    methods = (approach[1], carry[1], leave[1])
    lift, carry_on = _split(
        carry[0], first_beyond(scene.robot, carry[0].q, request.hand.T_flange_tool, request.lines.retract)
    )
    sigma = float(found.sigma[0, slot])
    return PickPlan(approach[0], lift, carry_on, leave[0], k, slot, sigma, methods, cleared)


def _split(whole: Trajectory, at: int) -> tuple[Trajectory, Trajectory]:
    """Lift and carry of one motion with the part; no sample is in both, since a repeated sample is a stop of one
    step.
    """
    first = Trajectory("lift", whole.q[: at + 1].copy(), whole.qd[: at + 1].copy(), whole.dt)
    return first, Trajectory("carry", whole.q[at + 1 :].copy(), whole.qd[at + 1 :].copy(), whole.dt)


__all__ = ["PickPlan", "PickRequest", "check_grasps", "plan_pick"]
