"""Cycle times of planned picks beside their lower bound, and the time of planning (`pickproof benchmark motion`).

Bins are filled and grasps chosen as in a run, with poses from ground truth. Each pick is planned from the end of the
last one, its workpiece is set to the planned place, and the next image is taken. Nothing is executed: `jaw_times` gives
the time of the jaws (a test compares it with the physics). Computation times are those of one core.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from pickproof.cell.frames import Array, invert
from pickproof.cell.physics.trajectory_execution import jaw_times
from pickproof.robots.collision.scene import CollisionScene
from pickproof.robots.kinematics.inverse import inverse
from pickproof.robots.kinematics.model import RobotModel
from pickproof.robots.plan.pick_plan import PickPlan
from pickproof.robots.plan.pick_request import PathSearch, PickRequest
from pickproof.robots.plan.time_bound import lower_bound, stop_at_each
from pickproof.scenarios.campaign.episode import oracle_perception
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.picking.arm_planner import request_of
from pickproof.scenarios.picking.episode_state import EpisodeState
from pickproof.scenarios.picking.execution import release_opening
from pickproof.scenarios.picking.grasp_selection import choose
from pickproof.scenarios.picking.heap_heightmap import Scan
from pickproof.scenarios.picking.plan_selection import decide
from pickproof.scenarios.picking.stages import Decision
from pickproof.scenarios.picking.workcell import Workcell

PICKS_OF_A_BIN = 14
"""Picks per bin: fewer than half of the workpieces, since a nearly empty bin is a different task."""
REPEATS = 3
"""Number of times each pick is planned; the shortest time counts, as the machine may be busy."""


@dataclass(frozen=True)
class Measured:
    """Times of one pick.

    Attributes:
        steady: it began at the end of another pick, not at home.
        motion_s: of the plan; jaws_s: closing and opening; the workpiece falls while the next image is taken.
        bound_s: of the motion; stop_s: of the motion that stops at every point.
        plan_s: of choosing among the candidates and planning, scene and height field included.
        ik_s: of one pose; collision_s: of one check.
    """

    steady: bool
    motion_s: float
    jaws_s: float
    bound_s: float
    stop_s: float
    plan_s: float
    ik_s: float
    collision_s: float


def measure(scenario: Scenario, picks: int) -> Iterator[Measured]:
    """That many picks, from as many bins as needed; a bin without further picks is left."""
    done, seed = 0, scenario.seed
    while done < picks:
        cell = Workcell.build(scenario, seed)
        try:
            for one in _empty(cell, seed, min(PICKS_OF_A_BIN, picks - done)):
                done += 1
                yield one
        finally:
            cell.close()
        seed += 1
        if seed - scenario.seed > picks:
            return


def summary(measured: list[Measured]) -> dict[str, Any]:
    """The figures for output: robot times over the picks that began at the end of another pick.

    `cycle_over_bound` is the whole cycle over the bound of its motion plus the same time of the jaws;
    `motion_over_bound` is the motion over the bound of the motion.
    """
    steady = [m for m in measured if m.steady]
    motion, jaws, bound, stop = (
        np.array([getattr(m, name) for m in steady]) for name in ("motion_s", "jaws_s", "bound_s", "stop_s")
    )
    cycle, whole = motion + jaws, np.isfinite(stop)  # some plans have lines that the arm cannot follow to their ends
    plan_ms = 1e3 * np.array([m.plan_s for m in measured])
    return {
        "picks": len(measured),
        "cycle_s": {"mean": float(cycle.mean()), "p95": float(np.quantile(cycle, 0.95))},
        "motion_s": float(motion.mean()),
        "jaws_s": float(jaws.mean()),
        "bound_s": float((bound + jaws).mean()),
        "cycle_over_bound": float(cycle.mean() / (bound + jaws).mean()),
        "motion_over_bound": float(motion.mean() / bound.mean()),
        "stop_at_each_s": float((stop + jaws)[whole].mean()) if whole.any() else None,
        "ik_us": 1e6 * min(m.ik_s for m in measured),
        "collision_us": 1e6 * float(np.median([m.collision_s for m in measured])),
        "plan_ms": {"median": float(np.median(plan_ms)), "p99": float(np.quantile(plan_ms, 0.99))},
    }


def _empty(cell: Workcell, seed: int, picks: int) -> Iterator[Measured]:
    """Picks of one bin, one after the other."""
    state = EpisodeState.of(cell)
    for attempt in range(picks):
        rng = np.random.default_rng((seed, 1, attempt))
        frame, ids = cell.capture(rng)
        estimates = oracle_perception(cell, frame, ids, rng)
        selection = choose(cell, frame, estimates, state, attempt)
        plan_seed = int(rng.integers(2**31))
        plan_s, decision = _quickest(partial(decide, cell, frame, selection, state, plan_seed))
        if decision.candidate is None or decision.plan is None:
            return
        request = request_of(cell, decision.candidate, state, PathSearch(seed=plan_seed))
        scene = CollisionScene(
            cell.robot,
            cell.gripper.flange_boxes(decision.candidate.opening),
            cell.obstacles,
            Scan.of(cell, frame).field,
        )
        yield _measured(cell, scene, request, decision, state.waits_at is not None, plan_s)
        _carry_out(cell, request, decision, estimates.Ts_world_part[decision.candidate.estimate], state)


def _measured(
    cell: Workcell, scene: CollisionScene, request: PickRequest, decision: Decision, steady: bool, plan_s: float
) -> Measured:
    plan, candidate = decision.plan, decision.candidate
    assert plan is not None and candidate is not None
    place = request.places.Ts_base_tool[plan.place]
    closing, opening = jaw_times(
        cell.arm.jaw,
        candidate.opening,
        candidate.point.width,
        release_opening(cell, cell.new_place(), candidate.opening, place),
    )
    return Measured(
        steady=steady,
        motion_s=plan.duration,
        jaws_s=closing + opening,
        bound_s=lower_bound(cell.robot, plan),
        stop_s=stop_at_each(cell.robot, request, plan),
        plan_s=plan_s,
        ik_s=_ik_time(cell.robot, request),
        collision_s=_collision_time(scene, request, plan),
    )


def _carry_out(
    cell: Workcell, request: PickRequest, decision: Decision, T_world_part: Array, state: EpisodeState
) -> None:
    """Set the workpiece to its planned place and wait until all is at rest; the arm waits there."""
    plan, candidate = decision.plan, decision.candidate
    assert plan is not None and candidate is not None
    distances = np.linalg.norm(cell.world.part_poses()[:, :3, 3] - T_world_part[:3, 3], axis=1)
    T_world_placed = request.places.Ts_base_tool[plan.place] @ invert(candidate.T_part_tool)
    cell.world.place_part(int(np.argmin(distances)), T_world_placed)
    cell.world.run_until_rest(2.0)
    state.placed.add(T_world_placed, state.place.fall)
    state.place.fill(plan.place)
    state.waits_at = plan.carry.q[-1]
    state.opened = release_opening(cell, cell.new_place(), candidate.opening, request.places.Ts_base_tool[plan.place])


def _ik_time(robot: RobotModel, request: PickRequest) -> float:
    """Time of inverse kinematics per flange pose, over 1,000 poses, in [s]."""
    Ts = request.places.Ts_base_tool @ invert(request.hand.T_flange_tool)
    Ts = np.concatenate([Ts] * (1000 // len(Ts) + 1))[:1000]
    return _quickest(lambda: inverse(robot, Ts, request.q_start))[0] / len(Ts)


def _collision_time(scene: CollisionScene, request: PickRequest, plan: PickPlan) -> float:
    """Time of one collision check of arm, tool and held part on the path to the place, in [s]."""
    scene.hold(request.part.held.seen_from(request.hand.T_flange_tool))
    rows = plan.carry.q[:: max(1, len(plan.carry.q) // 50)]
    seconds, _ = _quickest(lambda: [scene.free(q) for q in rows])
    scene.release()
    return seconds / len(rows)


def _quickest(call: Callable[[], Any]) -> tuple[float, Any]:
    """Processor time in [s] of a call, and its result."""
    seconds, result = np.inf, None
    for _ in range(REPEATS):
        start = time.process_time()
        result = call()
        seconds = min(seconds, time.process_time() - start)
    return float(seconds), result
