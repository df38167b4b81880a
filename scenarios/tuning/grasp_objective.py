"""The first stage of `pickproof tune`: one grasp by itself, on a lone workpiece in the physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from pickproof.cell.frames import Array, apply, from_rpy, invert
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.grasping.candidates import GraspCandidate
from pickproof.grasping.grasp_points import GraspPoint, opening
from pickproof.scenarios.grasp_trials.check import lying
from pickproof.scenarios.grasp_trials.robustness import KEYS
from pickproof.scenarios.grasp_trials.trial import SHIFT, Trial, TrialCell, moved_by_error, turn_errors
from pickproof.scenarios.tuning.optimizer import Told

DRAWS = 6
"""Errors of the pose, the same ones for every trial of a search, beside none."""
POSES_TRIED = 2
"""Resting poses, likeliest first, of those that leave the gripper room."""
HOPELESS = 3  # errors, none among them, after which a grasp that never held is given up
SLIP = 0.005  # [m] in the fingers that costs a held trial half of what it is worth
PUSHED, PUSH_COST = 0.010, 0.4  # [m] by which closing moves the workpiece, and what that costs a held trial
OPEN_COST, FAR_COST = 0.15, 0.05  # of the widest opening, and of the farthest move: where physics cannot tell, less
NEARLY = {"lost in the shake": 0.2, "lost in the lift": 0.15}  # what a grasp is worth that held for a while
STRADDLED = 0.1  # and one that held nothing, by how nearly its fingers go over the workpiece
SURFACE = 4000  # points of the workpiece


@dataclass(frozen=True)
class GraspTask:
    """A grasp point to be tried, with what it costs to be so far from the start; sent to worker processes."""

    workpiece: str
    gripper: str
    point: GraspPoint
    errors: Array
    distance: float = 0.0


def draw_errors(
    rng: np.random.Generator, workpiece: Workpiece, p95: dict[str, float] | None = None, draws: int = DRAWS
) -> Array:
    """Errors of a pose T_part_estimate (1 + draws, 4, 4): none, then normal ones along and about all six directions.

    Args:
        p95: size in [mm] and [deg] by direction that 95 % of perception's stay under; None for deviations of 1.5 mm
            and 2 degrees, less about an axis that the workpiece stands out far from (`turn_errors`).
    """
    if p95 is None:
        deviation = np.concatenate([[SHIFT] * 3, turn_errors(workpiece)])
    else:
        sizes = np.array([p95[key] for key in KEYS]) / 1.96
        deviation = np.concatenate([1e-3 * sizes[:3], np.deg2rad(sizes[3:])])
    errors = [np.eye(4)]
    for row in rng.normal(0.0, deviation, (draws, 6)):
        errors.append(from_rpy(row[:3], row[3:]))
    return np.stack(errors)


def try_point(task: GraspTask) -> Told:
    """Share of the errors under which the grasp holds, less for slip, pushes, a wide opening and for being moved far.

    Each error is tried at another of the poses that the grasp point stands for: turned, slid, or of a symmetric copy.
    Where it does not hold it is worth a little the nearer it came: a search that sees only zeros finds nothing.
    """
    cell, resting = _cell(task.workpiece, task.gripper)
    cell.rebuild()
    tries = _tries(cell, resting, task)
    value = float(np.mean([worth for _, worth in tries])) if tries else 0.0
    return Told(value - _cost(task), _detail([trial for trial, _ in tries]))


def _tries(cell: TrialCell, resting: Array, task: GraspTask) -> list[tuple[Trial, float]]:
    """The grasp under every error in POSES_TRIED resting poses, each with its worth; given up where it is HOPELESS."""
    tries: list[tuple[Trial, float]] = []
    for k, candidates in list(lying(task.point, resting, cell.workpiece, cell.gripper))[:POSES_TRIED]:
        spread = np.linspace(0, len(candidates) - 1, len(task.errors)).round().astype(int)
        for i, error in enumerate(task.errors):
            grasp = candidates[spread[i]]
            T_world_tool = moved_by_error(error, resting[k], cell.workpiece) @ grasp.T_world_tool
            trial = cell.try_grasp(resting[k], T_world_tool, grasp.opening)
            tries.append((trial, _worth(cell, resting[k], grasp, trial)))
            if i + 1 == HOPELESS and not any(t.held for t, _ in tries):
                return tries
    return tries


def _worth(cell: TrialCell, T_world_part: Array, grasp: GraspCandidate, trial: Trial) -> float:
    """Of one trial, 1 at most: less where the workpiece slid or was pushed, little where it was not held."""
    if trial.held:
        return 1.0 - 0.5 * min(trial.slip / SLIP, 1.0) - PUSH_COST * min(trial.pushed / PUSHED, 1.0)
    near = STRADDLED * straddled(cell, T_world_part, grasp.T_world_tool, grasp.opening)
    return NEARLY.get(trial.reason, near)


def _cost(task: GraspTask) -> float:
    """Of a wide opening and of being far from the start."""
    wide = (opening(task.point) - task.point.width) / 0.03
    return OPEN_COST * wide + FAR_COST * task.distance


def _detail(trials: Sequence[Trial]) -> dict[str, Any]:
    """What is kept beside the value: share held, largest slip and push, and the most frequent reason of failure."""
    reasons = [t.reason for t in trials if not t.held]
    reason = max(set(reasons), key=lambda r: (reasons.count(r), r)) if reasons else ""
    return {
        "share": sum(t.held for t in trials) / len(trials) if trials else 0.0,
        "trials": len(trials),
        "slip_mm": round(1000 * max((t.slip for t in trials), default=0.0), 3),
        "reason": reason if trials else "no room",
        "pushed_mm": round(1000 * max((t.pushed for t in trials if t.held), default=0.0), 3),
    }


def straddled(cell: TrialCell, T_world_part: Array, T_world_tool: Array, wide: float) -> float:
    """How nearly an open jaw goes over what of the workpiece is within two fingers of it, in [0, 1]; pads: 0.

    The mean over that surface of 1 between the fingers, and beyond of half the opening over the distance from the
    middle. It says nothing about friction or tipping, but has a slope where the fingers come down on the workpiece.
    """
    if not isinstance(cell.gripper, ParallelJaw):
        return 0.0
    points = apply(invert(T_world_tool) @ T_world_part, cell.workpiece.sample_surface(SURFACE)[0])
    thick, width, length = cell.gripper.finger_size
    met = (np.abs(points[:, 1]) < width / 2) & (points[:, 2] > -length) & (points[:, 2] < 0.0)
    off = np.abs(points[met & (np.abs(points[:, 0]) < wide / 2 + 2 * thick), 0])
    return float(np.minimum(0.5 * wide / np.maximum(off, 1e-9), 1.0).mean()) if len(off) else 0.0


@lru_cache(maxsize=1)
def _cell(workpiece: str, gripper: str) -> tuple[TrialCell, Array]:
    """Kept by the process: a client of the physics costs 28 MB that never come back."""
    cell = TrialCell(load_workpiece(workpiece), load_gripper(gripper))
    return cell, cell.resting_poses()
