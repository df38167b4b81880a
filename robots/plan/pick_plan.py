"""The motion of one pick: to the part, out of the bin, to a free place, and, if asked for, away from it.

The arm rests where the process must stop and nowhere else:
    approach  q_start -> (straight up, out of the last place) -> through the air -> straight line to the grasp
    lift      straight line out of the pile, part held, and on in a blended motion
    carry     -> straight line down to a place pose
    leave     straight line up -> q_end, where one is given; else the arm waits at the place, its jaws open
All of them stay in one front-facing branch of the arm between grasp and place, so the wrist never flips with a part in
hand, and every trajectory is checked for collisions.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from pickproof.cell.frames import Array, invert
from pickproof.robots.collision.checker import Mode
from pickproof.robots.collision.held_part import HeldPart
from pickproof.robots.collision.scene import CollisionScene, HeightField
from pickproof.robots.failure import Cause, PlanFailure, Refusal, Stage
from pickproof.robots.kinematics.inverse import FRONT, SIGMA_MIN, Branches, flange_poses, inverse
from pickproof.robots.motion.dynamics import Load
from pickproof.robots.motion.stop import Line, Pace, Stop, first_beyond
from pickproof.robots.motion.timing import JointPath, rest_to_rest
from pickproof.robots.motion.trajectory import DT, Trajectory
from pickproof.robots.plan.free_motion import Joined, join
from pickproof.robots.plan.path_search import Method

PLACES_TRIED = 12  # place poses to which a blended motion is looked for in vain
EARLY = 3  # blended motions in vain one after the other that met something early: where they end hardly matters then
SEARCHED_PLACES = 2  # place poses for which a path is searched when no quick way leads to any
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class PickRequest:
    """What one pick asks for; poses of the TCP in the robot's base frame, which is the world frame.

    Attributes:
        q_start: (6,) joint vector at rest now [rad]; q_end: the one to return to, None to wait at the place.
        T_base_tool_grasp: (4, 4) TCP at the grasp; z is the approach direction, x the closing direction of the jaws.
        Ts_base_tool_place: (k, 4, 4) TCP where the part may be let go, most wanted first.
        T_flange_tool: (4, 4).
        held: the part in the TCP frame.
        approach: length of the last line, along tool z to the grasp [m].
        retract: length of the first line with the part [m]; retract_direction: a unit vector in the world.
        clear: of that line up to where the part is out of the bin [m]; where it is longer than `retract` and the arm
            can follow it, the blended motion may begin as late as there.
        place_height: of the vertical line down to a place pose [m]; depart: of the vertical line away from q_start, 0
            for none.
        straight: length that is kept straight of each of these lines where the rest of it may be rounded into the
            blended motion without a touch [m]; None for the whole lines. straight_place: the same of the lines at the
            place; None for as much as at the grasp.
        narrowing: time in [s] that the jaws take from how they are at q_start to how they grip; they start when the
            hand has left by `depart`, and until they are done the blended motion has room for both.
        place_rank: (k,) how much each place pose is wanted, the least first; among equals the quickest to reach is
            taken. None for the order given.
        speed: in (0, 1] of the arm's speed, see `robots.motion.trajectory`.
        carry_acceleration: largest acceleration of the TCP with the part [m/s2].
        tool_load, part_load: what gripper and part weigh on the flange, for the torques; None for nothing.
        held_tolerance: error of the part's estimated pose [m] that does not count as a collision on the lift's line.
        pile_without: the scanned pile once the part is out of it; None for the scan as it is, the part in it.
        seed: of the path search, which runs only where straight moves and via points fail; searched: if at all.
    """

    q_start: Array
    T_base_tool_grasp: Array
    Ts_base_tool_place: Array
    T_flange_tool: Array
    held: HeldPart
    q_end: Array | None
    approach: float = 0.10
    retract: float = 0.15
    retract_direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    clear: float = 0.0
    place_height: float = 0.12
    speed: float = 1.0
    carry_acceleration: float = 15.0
    held_tolerance: float = 0.005
    seed: int = 0
    searched: bool = True
    dt: float = DT
    depart: float = 0.0
    narrowing: float = 0.0
    straight: float | None = None
    straight_place: float | None = None
    place_rank: tuple[int, ...] | None = None
    tool_load: Load | None = None
    part_load: Load | None = None
    pile_without: HeightField | None = None

    @property
    def way_back(self) -> Array:
        """(3,) [m] from the grasp to where the last line to it begins."""
        return np.asarray(-self.approach * self.T_base_tool_grasp[:3, 2])

    @property
    def free(self) -> Pace:
        """Of the empty hand."""
        return Pace(self.speed, self.dt, self.T_flange_tool, None, self.tool_load)

    @property
    def slow(self) -> Pace:
        """With the part."""
        loads = [load for load in (self.tool_load, self.part_load) if load is not None]
        both = sum(loads[1:], loads[0]) if loads else None
        return Pace(self.speed, self.dt, self.T_flange_tool, self.carry_acceleration, both)


@dataclass(frozen=True, eq=False)
class PickPlan:
    """The trajectories of a pick in order, and how they were found.

    Attributes:
        lift: ends in a blended motion, at the height of the whole line; carry goes on from there without a stop.
        leave: a single joint vector where the arm waits at the place.
        place: index of the place pose used; branch: of grasp and place; sigma: of the grasp.
        methods: how the free moves of approach, carry and leave were found.
        cleared: samples of `approach` before the hand has left the last place; the jaws stay as they are until then.
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

    The branch that is quicker to reach is tried first; the failure told is that of the first one the grasp exists in.
    The scene comes back holding nothing.
    """
    grasp = request.T_base_tool_grasp @ invert(request.T_flange_tool)
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
    return _failure(stops)


def check_grasps(scene: CollisionScene, Ts_base_tool: Array, T_flange_tool: Array) -> Iterator[PlanFailure | None]:
    """For each TCP grasp pose (n, 4, 4) in turn: None where the arm can stand there freely, or why it cannot.

    The inverse kinematics of all poses is done at the first step, each collision check when its turn comes: stop asking
    when enough are found.
    """
    found = inverse(scene.robot, np.asarray(Ts_base_tool) @ invert(T_flange_tool))
    for k in range(len(found.q)):
        stops: list[PlanFailure] = []
        for slot in FRONT:
            stop = _standing(scene, found, k, slot, "contact")
            if stop is None:
                break
            stops.append(stop)
        if len(stops) < len(FRONT):
            yield None
        else:
            yield _failure(stops)


def _failure(stops: list[PlanFailure]) -> PlanFailure:
    """That of the first branch within the joint limits, if there is one."""
    near = [(s.stage, s.cause) for s in stops]
    told = next((s for s, n in zip(stops, near, strict=True) if n > (Stage.GRASP, Cause.JOINT_LIMIT)), None)
    return told or stops[near.index(max(near))]


def _plan_in_branch(
    scene: CollisionScene, request: PickRequest, grasp: Array, found: Branches, slot: int
) -> PickPlan | PlanFailure:
    """The pick in one branch, or where it stopped."""
    blocked = _standing(scene, found, 0, slot, "contact")
    if blocked is not None:
        return blocked
    q_grasp = found.q[0, slot]

    out = _stop(scene, request, grasp, q_grasp, request.way_back, "contact", Stage.APPROACH_LINE, "approach line")
    if isinstance(out, PlanFailure):
        return out
    up = _lift(scene, request, grasp, q_grasp)
    if isinstance(up, PlanFailure):
        return up
    start = _start(scene, request)
    if isinstance(start, PlanFailure):
        return start
    approach = join(scene, start, out, request.free, request.seed, "approach", request.searched)
    if isinstance(approach, Refusal):
        return PlanFailure(Stage.APPROACH, approach, "way to the grasp")
    q, away = approach[0].q, request.depart
    cleared = first_beyond(scene.robot, q, request.T_flange_tool, away) if away else 0
    narrow = cleared + int(np.ceil(request.narrowing / request.dt))
    contact = scene.path_contact(q[cleared : narrow + 1], "leave") if request.narrowing else None
    if contact is not None:  # where the arm stopped on its way, the jaws may meet something before they are narrow
        return PlanFailure(Stage.APPROACH, Refusal(Cause.COLLISION, contact=contact), "way to the grasp")
    scene.hold(request.held.seen_from(request.T_flange_tool), request.held_tolerance, request.pile_without)
    placed = _place(scene, request, up, slot)
    if isinstance(placed, PlanFailure):
        return placed
    k, carry, leave = placed
    methods = (approach[1], carry[1], leave[1])
    lift, carry_on = _split(carry[0], first_beyond(scene.robot, carry[0].q, request.T_flange_tool, request.retract))
    sigma = float(found.sigma[0, slot])
    return PickPlan(approach[0], lift, carry_on, leave[0], k, slot, sigma, methods, cleared)


def _lift(scene: CollisionScene, request: PickRequest, grasp: Array, q: Array) -> Stop | PlanFailure:
    """The grasp with the line away from it, which goes on till the part is out of the bin if the arm can follow it."""
    way = np.array(request.retract_direction)
    if request.clear > request.retract:
        line = Line(scene.robot, grasp, q, request.clear * way)
        if isinstance(line.path, JointPath):
            return Stop(q, line, "contact", request.straight or request.retract)
    return _stop(scene, request, grasp, q, request.retract * way, "contact", Stage.LIFT_LINE, "lift line")


def _start(scene: CollisionScene, request: PickRequest) -> Stop | PlanFailure:
    """Where the arm rests now, with the line away from it."""
    if not request.depart:
        return Stop(request.q_start)
    T = flange_poses(scene.robot, request.q_start[None])[0]
    rise, what = request.depart * UP, "line from the start"
    stop = _stop(scene, request, T, request.q_start, rise, "depart", Stage.APPROACH, what)
    if isinstance(stop, PlanFailure):
        return stop
    if stop.line is not None and isinstance(stop.line.path, JointPath):
        ways = stop.line.path.spline(np.linspace(0.0, 1.0, 9))
        touched = next((c for q in ways if (c := scene.first_contact(q, "depart"))), None)
        if touched is not None and touched[1] == "placed":  # it stands there; straight up is the only way out
            scene.stands_among_placed()
    return replace(stop, narrowing=request.narrowing)


def _place(
    scene: CollisionScene, request: PickRequest, grasp: Stop, slot: int
) -> tuple[int, Joined, Joined] | PlanFailure:
    """The first place pose that can be reached with the part and left without it; quick ways first, then a search."""
    poses = request.Ts_base_tool_place @ invert(request.T_flange_tool)
    found = inverse(scene.robot, poses, grasp.q)
    if len(poses) == 0:
        return PlanFailure(Stage.PLACE, Refusal(Cause.NO_PLACE), "place")
    blocked: list[PlanFailure] = []
    unseen: list[tuple[int, Stop]] = []
    early = 0
    for k in _in_order(scene, request, found, slot, grasp.q):
        if len(unseen) >= PLACES_TRIED or early >= EARLY:
            break
        stop = _standing(scene, found, k, slot, "transit")
        if stop is not None:
            blocked.append(replace(stop, stage=Stage.PLACE, where=f"place pose {k}"))
            continue
        q = found.q[k, slot]
        rise = request.place_height * UP
        what = f"line to place pose {k}"
        place = _stop(scene, request, poses[k], q, rise, "transit", Stage.PLACE_LINE, what)
        if isinstance(place, PlanFailure):
            blocked.append(place)
            continue
        if request.q_end is None and place.line is not None and isinstance(place.line.path, Refusal):
            # what comes down only the last bit straight could not leave the next time: it would hit what it let go
            blocked.append(PlanFailure(Stage.PLACE_LINE, place.line.path, what))
            continue
        done = _carry(scene, request, grasp, place, None, k)
        if not isinstance(done, PlanFailure):
            return k, *done
        blocked.append(done)
        if done.stage == Stage.CARRY:
            unseen.append((k, place))
            early = early + 1 if done.refusal.early else 0
    for k, place in unseen[: SEARCHED_PLACES if request.searched else 0]:
        done = _carry(scene, request, grasp, place, request.seed, k)
        if not isinstance(done, PlanFailure):
            return k, *done
        blocked.append(done)
    return max(blocked, key=lambda s: (s.stage, s.cause, s.refusal.contact is not None))


def _in_order(scene: CollisionScene, request: PickRequest, found: Branches, slot: int, q_grasp: Array) -> list[int]:
    """Indices of the place poses, most wanted first, and of those equally wanted the quickest to reach."""
    n = len(found.q)
    if request.place_rank is None:
        return list(range(n))
    far = np.where(found.exists[:, slot], rest_to_rest(scene.robot, found.q[:, slot] - q_grasp), np.inf)
    return sorted(range(n), key=lambda k: ((request.place_rank or ())[k], far[k]))


def _carry(
    scene: CollisionScene, request: PickRequest, grasp: Stop, place: Stop, seed: int | None, k: int
) -> tuple[Joined, Joined] | PlanFailure:
    """With the part to a place pose, and without it home or nowhere."""
    carry = join(scene, grasp, place, request.slow, seed, "carry")
    if isinstance(carry, Refusal):
        return PlanFailure(Stage.CARRY, carry, f"way to place pose {k}")
    if request.q_end is None:
        return carry, (Trajectory("leave", place.q[None].copy(), np.zeros((1, 6)), request.dt), "direct")
    with scene.empty_handed():
        leave = join(scene, place, Stop(request.q_end), request.free, request.seed, "leave")
    if isinstance(leave, Refusal):
        return PlanFailure(Stage.LEAVE, leave, f"way home from place pose {k}")
    return carry, leave


def _stop(
    scene: CollisionScene, request: PickRequest, T: Array, q: Array, way: Array, mode: Mode, stage: Stage, what: str
) -> Stop | PlanFailure:
    """A stop at flange pose T with a line by `way` (3,) in the world, of which at least the beginning is reachable."""
    straight = request.straight if mode == "contact" else request.straight_place or request.straight
    stop = Stop(q, Line(scene.robot, T, q, way), mode, straight)
    usable = stop.usable
    return PlanFailure(stage, usable, what) if isinstance(usable, Refusal) else stop


def _split(whole: Trajectory, at: int) -> tuple[Trajectory, Trajectory]:
    """Lift and carry of one motion with the part; no sample is in both, or the arm would stand still for a step."""
    first = Trajectory("lift", whole.q[: at + 1].copy(), whole.qd[: at + 1].copy(), whole.dt)
    return first, Trajectory("carry", whole.q[at + 1 :].copy(), whole.qd[at + 1 :].copy(), whole.dt)


def _standing(scene: CollisionScene, found: Branches, k: int, slot: int, mode: Mode) -> PlanFailure | None:
    """Why the arm cannot stand at pose k in a branch: by itself, or by what it would touch."""
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
