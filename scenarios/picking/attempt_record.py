"""The record of an attempt, built from the frozen results of its stages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pickproof.cell.frames import to_quat_xyzw
from pickproof.cell.physics.observation import Snapshot
from pickproof.scenarios.picking.cell_model import SOURCE
from pickproof.scenarios.picking.decision_tree import decision_tree, tree_json
from pickproof.scenarios.picking.outcome import Outcome, PoseError
from pickproof.scenarios.picking.stages import Considered
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.results.records import AttemptRecord, Rows, nested


@dataclass(frozen=True)
class AttemptKey:
    """Which attempt: the seed of its episode, and its index there from 0; no-picks are counted along."""

    seed: int
    attempt: int


def attempt_record(
    cell: Workcell, key: AttemptKey, considered: Considered, outcome: Outcome, pictures: Mapping[str, bytes]
) -> AttemptRecord:
    """The record of a pick or a no-pick; its `wall_s` is left at 0."""
    estimates, pick, evidence = considered.estimates, considered.decision.pick, outcome.evidence
    return AttemptRecord(
        seed=key.seed,
        attempt=key.attempt,
        moved=evidence is not None,
        success=outcome.success,
        reason=outcome.reason,
        parts_in_bin_before=len(considered.before.parts_in(SOURCE)),
        n_estimates=len(estimates.scores),
        estimate_T_world_part=None if pick is None else nested(estimates.Ts_world_part[pick.candidate.estimate]),
        estimate_score=None if pick is None else estimates.scores[pick.candidate.estimate],
        error_mm=_mm(outcome.pose_error),
        error_deg=_deg(outcome.pose_error),
        grasp="" if pick is None else pick.candidate.point.name,
        sensing_s=cell.scenario.camera.sensing_time_s,
        perceive_s=considered.times.perceive_s,
        choose_s=considered.times.choose_s,
        plan_s=considered.times.plan_s,
        robot_s=0.0 if evidence is None else evidence.seconds,
        part_poses_after=_poses(outcome.after),
        tree=tree_json(decision_tree(considered, evidence, cell.gripper_boxes)),
        pictures=dict(pictures),
        place_mm=_mm(outcome.place_error),
        place_deg=_deg(outcome.place_error),
        waypoints=None if pick is None else cell.carrier.waypoints(cell, pick.plan),
    )


def _poses(snapshot: Snapshot) -> Rows:
    """(n, 7) of all workpieces: position [m] and quaternion in the order x, y, z, w."""
    Ts = snapshot.Ts_world_part
    return nested(np.concatenate([Ts[:, :3, 3], to_quat_xyzw(Ts)], axis=1))


def _mm(error: PoseError | None) -> float | None:
    return None if error is None else 1000 * error.metres


def _deg(error: PoseError | None) -> float | None:
    return None if error is None else float(np.rad2deg(error.radians))
