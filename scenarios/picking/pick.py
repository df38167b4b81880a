"""The story of one pick: capture, perceive, choose, plan, move, close, lift, carry, place, judge."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from pickproof.cell.clock import working_time
from pickproof.cell.frames import Array, invert, to_quat_xyzw
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.grasping.candidates import GraspCandidate
from pickproof.grasping.verdict import CHOSEN
from pickproof.robots.plan.pick_plan import PickPlan
from pickproof.robots.program.waypoints import waypoints_of, waypoints_to_json
from pickproof.scenarios.picking.decision_tree import decision_tree
from pickproof.scenarios.picking.episode_state import EpisodeState
from pickproof.scenarios.picking.execution import move
from pickproof.scenarios.picking.grasp_selection import choose
from pickproof.scenarios.picking.outcome import Evidence, judge, nearest_true
from pickproof.scenarios.picking.plan_selection import decide, stopped_at_place
from pickproof.scenarios.picking.recorder import Recorder
from pickproof.scenarios.picking.snapshots import depth_picture, snap
from pickproof.scenarios.picking.stages import Estimates
from pickproof.scenarios.picking.workcell import PLACE, SOURCE, Workcell
from pickproof.scenarios.placing.factory import Place
from pickproof.scenarios.placing.heap_placing import place_error
from pickproof.scenarios.results.records import AttemptRecord, nested

PICTURED = 2
"""Attempts of an episode that are pictured at every stage; failures are pictured anyway, after the fact."""
Perceive = Callable[[Workcell, DepthFrame, np.ndarray, np.random.Generator], Estimates]
"""PS6D, or the oracle that is given the instance ids as well."""


def attempt_pick(
    cell: Workcell, perceive: Perceive, state: EpisodeState, seed: int, attempt: int, recorder: Recorder | None = None
) -> AttemptRecord:
    """One attempt, from the depth image to the judged outcome.

    Args:
        recorder: keeps the attempt to look at again, where one is wanted.
    """
    start = time.perf_counter()
    rng = np.random.default_rng((seed, 1, attempt))
    before = cell.observe()
    if recorder is not None:
        recorder.start()
    frame, ids = cell.capture(rng)

    clock = working_time()
    estimates = perceive(cell, frame, ids, rng)
    perceived = working_time()
    selection = choose(cell, frame, estimates, state, attempt)
    chosen_at = working_time()
    decision = decide(cell, frame, selection, state, int(rng.integers(2**31)))
    planned = working_time()

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
        if any(stopped_at_place(failure) for failure in decision.refused.values()):
            state.place.pass_over()
        record |= {"moved": False, "success": False, "reason": decision.reason}
    else:
        T_world_part = estimates.Ts_world_part[decision.candidate.estimate]
        _, error, angle = nearest_true(T_world_part, before.Ts_world_part, cell.workpiece)
        pose_ok = error < cell.workpiece.tolerance
        wrist = np.random.default_rng((seed, 2, attempt))
        shots = record["pictures"]
        evidence, robot_s = move(
            cell, state.place, decision.candidate, decision.plan, before, pose_ok, staged, shots, wrist
        )
        if evidence.weighed is not None:
            for node in record["tree"][decision.candidate.estimate]["candidates"]:
                if node["verdict"] == CHOSEN:
                    node["weighed"] = str(evidence.weighed)
        if evidence.log.stopped:
            for node in record["tree"][decision.candidate.estimate]["candidates"]:
                if node["verdict"] == CHOSEN:
                    node["after_stop"] = "set back by hand" if evidence.set_back else "drew back"
        if evidence.set_back:
            state.waits_at = None
        elif evidence.closed and not evidence.put_back and not evidence.log.stopped:
            state.waits_at = decision.plan.carry.q[-1]
        elif state.waits_at is not None:
            state.waits_at = cell.arm.q  # over the last place, on the way that it came
        state.opened = cell.arm.opening
        limits, after = cell.scenario.limits, evidence.after
        if set(evidence.carried) & set(after.parts_in(PLACE)):
            off, turned = how_placed(cell, decision.candidate, decision.plan, state.place, evidence)
            record |= {"place_mm": 1000 * off, "place_deg": np.rad2deg(turned)}
            evidence = replace(evidence, in_tolerance=state.place.accepts(off, turned))
        verdict = judge(evidence, limits.contact_force_N, limits.attempt_timeout_s)
        lost = bool(evidence.lifted) and not (evidence.carried or evidence.put_back or evidence.log.stopped)
        if evidence.carried or lost:  # what a cell's own gripper tells it; the verdict is ground truth
            state.placed.add(let_go_at(decision.candidate, decision.plan, state.place), state.place.fall)
            state.place.fill(decision.plan.place)  # lost on the way it may lie there: nothing else goes to that place
        if not evidence.carried:
            state.failed.append((attempt, T_world_part[:3, 3]))
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
            else waypoints_to_json(
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
    if recorder is not None:
        recorder.stop(done, frame, estimates, selection, decision)
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
