"""The motion of one pick: to the part, out of the bin, to a free place, and home.

Four trajectories, each from rest to rest:
    approach  q_start -> pre-grasp -> straight line to the grasp
    lift      straight line out of the pile, part held
    carry     -> above a place pose -> straight line down, part held
    leave     straight line up -> q_end
All of them stay in one front-facing branch of the arm between pre-grasp and place, so the wrist never flips with a part
in hand, and every sample of every trajectory is checked for collisions.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Literal

import numpy as np

from cell.bin import Box
from cell.frames import Array, invert
from robots.collision import CollisionScene, Mode
from robots.inverse import FRONT, SIGMA_MIN, Branches, branch, inverse
from robots.join import Joined, Pace, describe, enter_line, run
from robots.model import RobotModel
from robots.search import Method
from robots.timing import JointPath
from robots.trajectory import DT, LINE_SAMPLES, Trajectory, reverse, tool_line

SEARCHED_PLACES = 2  # place poses for which a path is searched when no quick way leads to any


@dataclass(frozen=True, eq=False)
class PickRequest:
    """What one pick asks for; poses of the TCP in the robot's base frame, which is the world frame.

    Attributes:
        q_start: (6,) joint vector at rest now [rad]; q_end: the one to return to.
        T_base_tool_grasp: (4, 4) TCP at the grasp; z is the approach direction, x the closing direction of the jaws.
        Ts_base_tool_place: (k, 4, 4) TCP where the part may be let go, most wanted first.
        T_flange_tool: (4, 4).
        held_tool: the part as boxes in the TCP frame.
        approach: length of the last line along tool z [m]; retract: of the first line with the part, along the unit
            vector `retract_direction` in the world; place_height: of the vertical line down to a place pose.
        speed: in (0, 1] of the arm's speed, see `robots.trajectory`.
        carry_acceleration: largest acceleration of the TCP with the part [m/s2].
        held_tolerance: error of the part's estimated pose [m] that does not count as a collision on the lift's line.
        seed: of the path search, which runs only where straight moves and via points fail.
    """

    q_start: Array
    T_base_tool_grasp: Array
    Ts_base_tool_place: Array
    T_flange_tool: Array
    held_tool: tuple[Box, ...]
    q_end: Array
    approach: float = 0.10
    retract: float = 0.15
    retract_direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    place_height: float = 0.12
    speed: float = 1.0
    carry_acceleration: float = 15.0
    held_tolerance: float = 0.005
    seed: int = 0
    dt: float = DT


@dataclass(frozen=True, eq=False)
class PickPlan:
    """The trajectories of a pick in order, the index of the place pose used, and how each free move was found."""

    approach: Trajectory
    lift: Trajectory
    carry: Trajectory
    leave: Trajectory
    place: int
    branch: int
    sigma: float
    methods: tuple[Method, Method, Method]

    @property
    def trajectories(self) -> tuple[Trajectory, Trajectory, Trajectory, Trajectory]:
        return self.approach, self.lift, self.carry, self.leave

    @property
    def duration(self) -> float:
        """Robot time in [s], without opening and closing the gripper."""
        return sum(t.duration for t in self.trajectories)


@dataclass(frozen=True)
class PlanFailure:
    """Why there is no motion: `unreachable` by the arm alone, or `no_path` because something is in the way."""

    reason: Literal["unreachable", "no_path"]
    detail: str


def plan_pick(scene: CollisionScene, request: PickRequest) -> PickPlan | PlanFailure:
    """Plan one pick. The same scene and request give the same plan, bit for bit.

    Branches are tried from the one of q_start on; the failure told is that of the first one the grasp exists in. The
    scene comes back holding nothing.
    """
    grasp = request.T_base_tool_grasp @ invert(request.T_flange_tool)
    found = inverse(scene.robot, grasp[None], request.q_start)
    stops = []
    for slot in _branches_in_order(scene.robot, request.q_start):
        scene.release()
        plan = _plan_in_branch(scene, request, grasp, found, slot)
        scene.release()
        if isinstance(plan, PickPlan):
            return plan
        stops.append(plan)
    return _failure(stops)


def check_grasps(scene: CollisionScene, Ts_base_tool: Array, T_flange_tool: Array) -> Iterator[PlanFailure | None]:
    """For each TCP grasp pose (n, 4, 4) in turn: None where the arm can stand there freely, or why it cannot.

    The inverse kinematics of all poses is done at the first step, each collision check when its turn comes: stop asking
    when enough are found.
    """
    found = inverse(scene.robot, np.asarray(Ts_base_tool) @ invert(T_flange_tool))
    for k in range(len(found.q)):
        stops = []
        for slot in FRONT:
            stop = _standing(scene, found, k, slot, "contact")
            if stop is None:
                break
            stops.append(stop)
        if len(stops) < len(FRONT):
            yield None
        else:
            yield _failure(stops)


class _Stage(IntEnum):
    """How far a plan got."""

    EXISTS, LIMITS, SINGULAR, GRASP, APPROACH_LINE, LIFT_LINE, APPROACH, PLACE, PLACE_LINE, CARRY, LEAVE = range(11)


@dataclass(frozen=True)
class _Stop:
    stage: _Stage
    reason: Literal["unreachable", "no_path"]
    detail: str


def _failure(stops: list[_Stop]) -> PlanFailure:
    """That of the first branch within the joint limits, if there is one."""
    told = next((s for s in stops if s.stage > _Stage.LIMITS), None) or max(stops, key=lambda s: s.stage)
    return PlanFailure(told.reason, told.detail)


def _plan_in_branch(
    scene: CollisionScene, request: PickRequest, grasp: Array, found: Branches, slot: int
) -> PickPlan | _Stop:
    """The pick in one branch, or where it stopped."""
    stop = _standing(scene, found, 0, slot, "contact")
    if stop is not None:
        return replace(stop, detail=f"grasp: {stop.detail}")
    q_grasp = found.q[0, slot]
    free = Pace(request.speed, request.dt, request.T_flange_tool)

    back = -request.approach * request.T_base_tool_grasp[:3, 2]
    out = _line(scene, grasp, back, q_grasp, "contact", _Stage.APPROACH_LINE, "approach line")
    if isinstance(out, _Stop):
        return out
    hold = tuple(replace(b, T_world_box=request.T_flange_tool @ b.T_world_box) for b in request.held_tool)
    scene.hold(hold, request.held_tolerance)
    rise = request.retract * np.array(request.retract_direction)
    up = _line(scene, grasp, rise, q_grasp, "contact", _Stage.LIFT_LINE, "lift line")
    scene.release()
    if isinstance(up, _Stop):
        return up
    approach = enter_line(scene, request.q_start, out.reversed(), free, request.seed, "approach")
    if isinstance(approach, str):
        return _Stop(_Stage.APPROACH, "no_path", f"way to the grasp: {approach}")
    scene.hold(hold, request.held_tolerance)
    lift = run(scene, up, replace(free, acceleration=request.carry_acceleration), "lift")

    placed = _place(scene, request, up.end, slot)
    if isinstance(placed, _Stop):
        return placed
    k, carry, leave = placed
    methods = (approach[1], carry[1], leave[1])
    return PickPlan(approach[0], lift, carry[0], leave[0], k, slot, float(found.sigma[0, slot]), methods)


def _place(
    scene: CollisionScene, request: PickRequest, q_lifted: Array, slot: int
) -> tuple[int, Joined, Joined] | _Stop:
    """The first place pose that can be reached with the part and left without it; quick ways first, then a search."""
    poses = request.Ts_base_tool_place @ invert(request.T_flange_tool)
    found = inverse(scene.robot, poses, q_lifted)
    rise = np.array([0.0, 0.0, request.place_height])
    if len(poses) == 0:
        return _Stop(_Stage.PLACE, "unreachable", "place: no place pose was given")
    stops: list[_Stop] = []
    blocked: list[tuple[int, JointPath]] = []
    for k, pose in enumerate(poses):
        stop = _standing(scene, found, k, slot, "transit")
        if stop is not None:
            stops.append(replace(stop, stage=_Stage.PLACE, detail=f"place pose {k}: {stop.detail}"))
            continue
        line = _line(scene, pose, rise, found.q[k, slot], "transit", _Stage.PLACE_LINE, f"line to place pose {k}")
        if isinstance(line, _Stop):
            stops.append(line)
            continue
        done = _carry(scene, request, q_lifted, line.reversed(), None, k)
        if not isinstance(done, _Stop):
            return k, *done
        stops.append(done)
        if done.stage == _Stage.CARRY:
            blocked.append((k, line))
    for k, line in blocked[:SEARCHED_PLACES]:
        done = _carry(scene, request, q_lifted, line.reversed(), request.seed, k)
        if not isinstance(done, _Stop):
            return k, *done
        stops.append(done)
    return max(stops, key=lambda s: s.stage)


def _carry(
    scene: CollisionScene, request: PickRequest, q_lifted: Array, line: JointPath, seed: int | None, k: int
) -> tuple[Joined, Joined] | _Stop:
    """With the part to the place pose at the end of `line`, and without it home."""
    free = Pace(request.speed, request.dt, request.T_flange_tool)
    slow = replace(free, acceleration=request.carry_acceleration)
    carry = enter_line(scene, q_lifted, line, slow, seed, "carry")
    if isinstance(carry, str):
        return _Stop(_Stage.CARRY, "no_path", f"way to place pose {k}: {carry}")
    with scene.empty_handed():
        leave = enter_line(scene, request.q_end, line, free, request.seed, "leave")
    if isinstance(leave, str):
        return _Stop(_Stage.LEAVE, "no_path", f"way home from place pose {k}: {leave}")
    return carry, (reverse(leave[0], "leave"), leave[1])


def _line(
    scene: CollisionScene, T0: Array, shift: Array, q0: Array, mode: Mode, stage: _Stage, what: str
) -> JointPath | _Stop:
    """The flange's straight line from T0 by `shift` (3,) in the world, reachable and free."""
    T1 = T0.copy()
    T1[:3, 3] += shift
    line = tool_line(scene.robot, T0, T1, q0)
    if isinstance(line, str):
        return _Stop(stage, "unreachable", f"{what}: {line}")
    contact = scene.path_contact(line.spline(np.linspace(0.0, 1.0, 2 * LINE_SAMPLES - 1)), mode)
    return line if contact is None else _Stop(stage, "no_path", f"{what}: {describe(contact)}")


def _standing(scene: CollisionScene, found: Branches, k: int, slot: int, mode: Mode) -> _Stop | None:
    """Why the arm cannot stand at pose k in a branch: by itself, or by what it would touch."""
    robot, q = scene.robot, found.q[k, slot]
    if not found.exists[k, slot]:
        return _Stop(_Stage.EXISTS, "unreachable", "out of reach, no IK branch")
    if not found.valid[k, slot]:
        joint = int(np.argmax((q < robot.lower) | (q > robot.upper))) + 1
        return _Stop(_Stage.LIMITS, "unreachable", f"joint limit of J{joint}")
    if found.sigma[k, slot] <= SIGMA_MIN:
        return _Stop(_Stage.SINGULAR, "unreachable", f"singularity margin (sigma {found.sigma[k, slot]:.3f})")
    contact = scene.first_contact(q, mode)
    return None if contact is None else _Stop(_Stage.GRASP, "no_path", describe(contact))


def _branches_in_order(robot: RobotModel, q_start: Array) -> list[int]:
    """Front-facing branches, the one with the wrist of q_start first."""
    wrist = int(branch(robot, q_start)) & 4
    return sorted(FRONT, key=lambda b: b & 4 != wrist)
