"""The story of one pick: capture, perceive, choose, plan, move, close, lift, carry, place, judge."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from cell.bin import Box
from cell.camera import DepthFrame
from cell.frames import Array, apply, invert, to_quat_xyzw
from cell.tool import in_frame
from grasping.candidates import GraspCandidate, Selection, select
from grasping.grasp_points import GraspPoses
from grasping.verdict import CHOSEN, Verdict
from robots.collision import CollisionScene, HeightField
from robots.dynamics import Load
from robots.failure import PlanFailure, Stage
from robots.plan import PickPlan, PickRequest, check_grasps, plan_pick
from robots.waypoints import waypoints_of
from scenarios.export_program import as_json
from scenarios.free_motion import free_plan
from scenarios.motion_rank import with_motion
from scenarios.move import move
from scenarios.outcome import Evidence, judge, nearest_true
from scenarios.pictures import depth_picture, snap
from scenarios.place import place_error
from scenarios.placed import Placed
from scenarios.placing import Place
from scenarios.records import AttemptRecord, Reason, nested
from scenarios.rehearsal import REHEARSALS
from scenarios.scan import Scan, scene_points, true_points
from scenarios.tree import RuledOut, decision_tree
from scenarios.workcell import PLACE, SOURCE, Workcell

PICTURED = 2
"""Attempts of an episode that are pictured at every stage; failures are pictured anyway, after the fact."""
PLANS_TRIED = 60
"""Candidates for which a whole motion is planned before giving up."""
PLANS_ELSEWHERE = 8
"""Of those that could be gripped, but not brought to any place offered: planned again to each further set of places."""
PLANS_A_ROUND = 4
"""Plans for one workpiece before the others get their turn: where the arm cannot go, the next grasp rarely helps."""
CARRY_ACCELERATION = 15.0  # [m/s2] of the TCP with a workpiece, at full speed scale
KNOWN_SCORE, KNOWN_SAMPLES = 0.7, 800
"""Estimates from this score on count as bodies for the gripper, by as many points of their surface."""
AVOID_RADIUS = 0.02  # [m] around a failed estimate within which estimates are left alone


@dataclass(frozen=True)
class Estimates:
    """What perception hands to grasping, best first.

    Attributes:
        Ts_world_part: (k, 4, 4).
        scores: (k,) in [0, 1].
        residuals: (k,) root mean square distance of the measured surface to the CAD in [m].
    """

    Ts_world_part: Array
    scores: Array
    residuals: Array


@dataclass(frozen=True)
class Decision:
    """What to do: a candidate with its plan, or the reason why the arm does not move.

    Attributes:
        refused: index of a candidate in the selection -> why it was ruled out when its turn came.
    """

    candidate: GraspCandidate | None
    plan: PickPlan | None
    reason: Reason | Literal[""]
    refused: dict[int, PlanFailure | RuledOut]


Perceive = Callable[[Workcell, DepthFrame, np.ndarray, np.random.Generator], Estimates]
"""PS6D, or the oracle that is given the instance ids as well."""


@dataclass
class Memory:
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
    def of(cell: Workcell) -> Memory:
        """Before the first pick."""
        return Memory(cell.new_place(), Placed(cell.place, cell.workpiece))

    def placeable(self, grasps: GraspPoses) -> np.ndarray:
        """(n,) bool: the grasp poses of the cell from which a workpiece can be put down as wanted; worked out once."""
        if self._placeable is None:
            self._placeable = self.place.placeable(grasps.Ts_part_tool)
        return self._placeable

    def avoided(self, Ts_world_part: Array, attempt: int, span: int) -> np.ndarray:
        """(k,) bool: the estimate lies where a pick failed within the last `span` attempts."""
        recent = [p for at, p in self.failed if attempt - at <= span]
        return np.array([any(np.linalg.norm(T[:3, 3] - p) < AVOID_RADIUS for p in recent) for T in Ts_world_part], bool)


def attempt_pick(cell: Workcell, perceive: Perceive, memory: Memory, seed: int, attempt: int) -> AttemptRecord:
    """One attempt, from the depth image to the judged outcome."""
    start = time.perf_counter()
    rng = np.random.default_rng((seed, 1, attempt))
    before = cell.observe()
    if cell.tape is not None:
        cell.tape.start()
    frame, ids = cell.capture(rng)

    clock = time.perf_counter()
    estimates = perceive(cell, frame, ids, rng)
    perceived = time.perf_counter()
    selection = choose(cell, frame, estimates, memory, attempt)
    chosen_at = time.perf_counter()
    decision = decide(cell, frame, selection, memory, int(rng.integers(2**31)))
    planned = time.perf_counter()

    record: dict[str, Any] = {
        "seed": seed,
        "attempt": attempt,
        "parts_in_bin_before": len(before.parts_in(SOURCE)),
        "n_estimates": len(estimates.scores),
        "sensing_s": cell.scenario.camera.sensing_time_s,
        "perceive_s": perceived - clock,
        "choose_s": chosen_at - perceived,
        "plan_s": planned - chosen_at,
        "tree": decision_tree(estimates, selection, decision, {box.name for box in cell.gripper.boxes(0.0)}),
        "pictures": {},
    }
    staged = cell.pictures and attempt < PICTURED
    if decision.candidate is None or decision.plan is None:
        after = cell.observe()
        if any(_stopped_at_place(failure) for failure in decision.refused.values()):
            memory.place.pass_over()
        record |= {"moved": False, "success": False, "reason": decision.reason}
    else:
        T_world_part = estimates.Ts_world_part[decision.candidate.estimate]
        _, error, angle = nearest_true(T_world_part, before.Ts_world_part, cell.workpiece)
        pose_ok = error < cell.workpiece.tolerance
        wrist = np.random.default_rng((seed, 2, attempt))
        shots = record["pictures"]
        evidence, robot_s = move(
            cell, memory.place, decision.candidate, decision.plan, before, pose_ok, staged, shots, wrist
        )
        if evidence.log.stopped:
            for node in record["tree"][decision.candidate.estimate]["candidates"]:
                if node["verdict"] == CHOSEN:
                    node["after_stop"] = "set back by hand" if evidence.set_back else "drew back"
        if evidence.set_back:
            memory.waits_at = None
        elif evidence.closed and not evidence.put_back and not evidence.log.stopped:
            memory.waits_at = decision.plan.carry.q[-1]
        elif memory.waits_at is not None:
            memory.waits_at = cell.arm.q  # over the last place, on the way that it came
        memory.opened = cell.arm.opening
        limits, after = cell.scenario.limits, evidence.after
        if set(evidence.carried) & set(after.parts_in(PLACE)):
            off, turned = how_placed(cell, decision.candidate, decision.plan, memory.place, evidence)
            record |= {"place_mm": 1000 * off, "place_deg": np.rad2deg(turned)}
            evidence = replace(evidence, in_tolerance=memory.place.accepts(off, turned))
        verdict = judge(evidence, limits.contact_force_N, limits.attempt_timeout_s)
        if evidence.carried:  # what a cell's own gripper tells it; the verdict is ground truth
            memory.placed.add(let_go_at(decision.candidate, decision.plan, memory.place), memory.place.fall)
            memory.place.fill(decision.plan.place)
        else:
            memory.failed.append((attempt, T_world_part[:3, 3]))
        record |= {
            "moved": True,
            "success": verdict == "",
            "reason": verdict,
            "estimate_T_world_part": nested(T_world_part),
            "estimate_score": estimates.scores[decision.candidate.estimate],
            "error_mm": 1000 * error,
            "error_deg": np.rad2deg(angle),
            "grasp": decision.candidate.point.name,
            "waypoints": None
            if "motion" in cell.oracle
            else as_json(
                waypoints_of(
                    cell.robot,
                    decision.plan,
                    cell.gripper.T_flange_tool,
                    cell.scenario.carry.straight,
                    cell.scenario.straight_place,
                )
            ),
            "robot_s": robot_s,
        }
    if staged or (cell.pictures and not record["success"]):
        record["pictures"]["depth"] = depth_picture(cell, frame, estimates, decision.candidate)
        if not record["success"]:
            snap(cell, record["pictures"], "after")
    poses = np.concatenate([after.Ts_world_part[:, :3, 3], to_quat_xyzw(after.Ts_world_part)], axis=1)
    done = AttemptRecord(part_poses_after=nested(poses), wall_s=time.perf_counter() - start, **record)
    if cell.tape is not None:
        cell.tape.stop(done, frame, estimates, selection, decision)
    return done


def how_placed(
    cell: Workcell, candidate: GraspCandidate, plan: PickPlan, place: Place, evidence: Evidence
) -> tuple[float, float]:
    """How far what was carried rests from where it was to be let go, in [m] and [rad]."""
    wanted = let_go_at(candidate, plan, place)
    return place_error(evidence.after.Ts_world_part[evidence.carried[0]], wanted, cell.workpiece)


def let_go_at(candidate: GraspCandidate, plan: PickPlan, place: Place) -> Array:
    """T_world_part (4, 4) of the workpiece where a plan lets it go, the place as it was when it was planned."""
    return place.tool_poses(candidate.T_part_tool, candidate.opening)[plan.place] @ invert(candidate.T_part_tool)


def choose(cell: Workcell, frame: DepthFrame, estimates: Estimates, memory: Memory, attempt: int) -> Selection:
    """Estimates times grasp points, checked for room and ranked; those without a place only where nothing else is free.

    The latter are refused when a plan is asked for, which tells that a regrasp would be needed.
    """
    can = memory.placeable(cell.grasps)
    selection = _choose(cell, frame, estimates, memory, attempt, cell.grasps.placeable(can))
    if not selection.candidates and not can.all():
        selection = _choose(cell, frame, estimates, memory, attempt, cell.grasps)
    return selection


def _choose(
    cell: Workcell, frame: DepthFrame, estimates: Estimates, memory: Memory, attempt: int, grasps: GraspPoses
) -> Selection:
    span = cell.scenario.stop.attempts_to_avoid
    selection = select(
        estimates.Ts_world_part,
        estimates.scores,
        memory.avoided(estimates.Ts_world_part, attempt, span),
        grasps,
        cell.workpiece,
        cell.gripper,
        cell.source,
        true_points(cell) if "grasp" in cell.oracle else heap_points(cell, frame, estimates),
        cell.scenario.grasping,
        estimates.residuals,
    )
    start = cell.robot.home if "motion" in cell.oracle else waits_at(cell, memory)  # joints of the arm, not a gantry's
    return with_motion(selection, cell.robot, start, cell.gripper.T_flange_tool, cell.scenario.grasping)


def heap_points(cell: Workcell, frame: DepthFrame, estimates: Estimates) -> Array:
    """Points (n, 3) in the world that the gripper keeps off: measured ones, and on the hidden sides of workpieces.

    A workpiece whose pose is believed is known all round; a finger that leans would else land on what it hides.
    """
    known = estimates.Ts_world_part[estimates.scores >= KNOWN_SCORE]
    surface = cell.workpiece.sample_surface(KNOWN_SAMPLES, seed=8)[0]
    hidden = apply(known, surface).reshape(-1, 3)
    return np.concatenate([scene_points(cell, frame), hidden])


def decide(cell: Workcell, frame: DepthFrame, selection: Selection, memory: Memory, seed: int) -> Decision:
    """The first candidate, best rank first, for which there is a whole motion to a free place."""
    if not selection.ruled_out:
        return Decision(None, None, Reason.NO_DETECTION, {})
    if not selection.candidates:
        return Decision(None, None, Reason.ALL_GRASPS_BLOCKED, {})
    planner = _FreePlanner(cell, frame, memory) if "motion" in cell.oracle else _ArmPlanner(cell, frame, memory, seed)
    order = in_rounds(selection.candidates)
    decision = _first_plan(cell, planner, selection, order, memory, {})
    for _ in range(memory.place.rounds - 1):
        again = [i for i in order if _stopped_at_place(decision.refused.get(i))][:PLANS_ELSEWHERE]
        if decision.plan is not None or not again:
            break
        memory.place.pass_over()
        decision = _first_plan(cell, planner, selection, again, memory, decision.refused)
    return decision


def _stopped_at_place(refused: PlanFailure | RuledOut | None) -> bool:
    """The grasp can be reached; what is refused is every way to the places that were offered."""
    return isinstance(refused, PlanFailure) and refused.stage >= Stage.PLACE


def _first_plan(
    cell: Workcell,
    planner: _ArmPlanner | _FreePlanner,
    selection: Selection,
    order: list[int],
    memory: Memory,
    refused: dict[int, PlanFailure | RuledOut],
) -> Decision:
    """The first candidate of those in `order` with a plan to the places offered now; `refused` is added to."""
    reason = Reason.NO_PLACE
    rehearsed: list[tuple[int, PickPlan]] = []
    first = planner.planned
    for i in order:
        candidate = selection.candidates[i]
        if not memory.place.placeable(candidate.T_part_tool[None])[0]:
            refused[i] = RuledOut(Verdict.NO_PLACE, "held so it cannot be put down as wanted")
            continue
        plan = planner(candidate)
        if isinstance(plan, PickPlan):
            fault = "" if cell.rehearsal is None else cell.rehearsal.refuses(candidate, cell.observe())
            if not fault:
                refused.pop(i, None)
                return Decision(candidate, plan, "", refused)
            rehearsed.append((i, plan))
            refused[i] = RuledOut(Verdict.REHEARSAL, fault)
        else:
            refused[i] = plan
            reason = Reason.NO_PATH if Reason.NO_PATH in (reason, plan.reason) else Reason.UNREACHABLE
        if planner.planned - first >= PLANS_TRIED or len(rehearsed) >= REHEARSALS:
            break
    if rehearsed:  # the grasp oracle chooses among grasps; it does not decide whether to pick
        best, plan = rehearsed[0]
        del refused[best]
        return Decision(selection.candidates[best], plan, "", refused)
    return Decision(None, None, reason, refused)


class _ArmPlanner:
    """Plans of the arm for one candidate after the other; collision scenes are built once for each opening."""

    def __init__(self, cell: Workcell, frame: DepthFrame, memory: Memory, seed: int) -> None:
        self._cell, self._memory, self._seed = cell, memory, seed
        self._scan = Scan.of(cell, frame)
        self._placed = memory.placed.heights(), memory.placed.heights(last=False)
        self._scenes: dict[float, CollisionScene] = {}
        self._piles: dict[int, HeightField] = {}
        self.planned = 0

    def __call__(self, candidate: GraspCandidate) -> PickPlan | PlanFailure:
        cell, opening = self._cell, candidate.opening
        scene = self._scenes.get(opening)
        if scene is None:
            waits = None if self._memory.waits_at is None else cell.gripper.flange_boxes(self._memory.opened)
            boxes = cell.gripper.flange_boxes(opening)
            scene = CollisionScene(cell.robot, boxes, cell.obstacles, self._scan.field, waits, *self._placed)
            self._scenes[opening] = scene
        stop = next(iter(check_grasps(scene, candidate.T_world_tool[None], cell.gripper.T_flange_tool)))
        if stop is not None:
            return stop
        self.planned += 1
        request = request_of(cell, candidate, self._memory, self._seed)
        return plan_pick(scene, replace(request, pile_without=self._pile_without(candidate)))

    def _pile_without(self, candidate: GraspCandidate) -> HeightField:
        k = candidate.estimate
        if k not in self._piles:
            T_world_part = candidate.T_world_tool @ invert(candidate.T_part_tool)
            self._piles[k] = self._scan.without(T_world_part, self._cell.workpiece)
        return self._piles[k]


class _FreePlanner:
    """Plans of the motion oracle."""

    def __init__(self, cell: Workcell, frame: DepthFrame, memory: Memory) -> None:
        self._cell, self._memory = cell, memory
        self._points = scene_points(cell, frame)
        self._acceleration = CARRY_ACCELERATION * cell.scenario.carry.speed_scale
        self.planned = 0

    def __call__(self, candidate: GraspCandidate) -> PickPlan | PlanFailure:
        self.planned += 1
        return free_plan(self._cell, self._points, candidate, self._memory, self._acceleration)


def in_rounds(candidates: list[GraspCandidate]) -> list[int]:
    """Indices of the candidates, best first, PLANS_A_ROUND of every estimate before the next ones of any."""
    seen: Counter[int] = Counter()
    rounds = []
    for candidate in candidates:
        rounds.append(seen[candidate.estimate] // PLANS_A_ROUND)
        seen[candidate.estimate] += 1
    return sorted(range(len(candidates)), key=lambda i: rounds[i])  # stable: rank decides within a round


def request_of(cell: Workcell, candidate: GraspCandidate, memory: Memory, seed: int) -> PickRequest:
    """What the planner is asked for one candidate."""
    T_flange_tool, T_tool_part = cell.gripper.T_flange_tool, invert(candidate.T_part_tool)
    boxes = [Box(f"held_{i}", size, T) for i, (size, T) in enumerate(cell.workpiece.piece_boxes())]
    places = memory.place.tool_poses(candidate.T_part_tool, candidate.opening)
    return PickRequest(
        q_start=waits_at(cell, memory),
        q_end=None,
        T_base_tool_grasp=candidate.T_world_tool,
        Ts_base_tool_place=places,
        T_flange_tool=T_flange_tool,
        held_tool=tuple(in_frame(boxes, T_tool_part)),
        approach=candidate.point.approach_distance,
        retract=candidate.point.retract_distance,
        place_height=memory.place.line,
        carry_acceleration=CARRY_ACCELERATION * cell.scenario.carry.speed_scale,
        seed=seed,
        dt=cell.world.dt,
        depart=0.0 if memory.waits_at is None else memory.place.line,
        straight=cell.scenario.carry.straight,
        straight_place=cell.scenario.straight_place,
        place_rank=memory.place.ranks(),
        tool_load=Load(cell.gripper.mass, cell.gripper.centre),
        part_load=Load(cell.workpiece.mass, apply(T_flange_tool @ T_tool_part, cell.workpiece.com[None])[0]),
    )


def waits_at(cell: Workcell, memory: Memory) -> Array:
    """Joint vector (6,) at which the arm stands now."""
    return cell.robot.home if memory.waits_at is None else memory.waits_at
