"""Estimates times grasp poses, each ruled out with its first reason or ranked."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from cell.bin import Bin
from cell.frames import Array
from cell.gripper import Gripper
from cell.workpiece import Workpiece
from grasping.clearance import hits_bin, points_in_gripper, thin, without_workpiece
from grasping.grasp_points import GraspPoint, GraspPoses

MAX_TILT = np.deg2rad(50.0)  # of the approach from the vertical
PER_ESTIMATE = 12
"""Candidates kept of one estimate: the next best of the same workpiece rarely helps where these failed."""


class Weights(Protocol):
    """Weights of the ranking; each term is in [0, 1]."""

    weight_score: float
    weight_height: float
    weight_upright: float
    weight_priority: float
    weight_clearance: float
    max_candidates: int


@dataclass(frozen=True)
class GraspCandidate:
    """One way to take one workpiece.

    Attributes:
        estimate: index of the estimate.
        point: the grasp point.
        T_world_tool: (4, 4) TCP at the grasp; T_part_tool: the same in the CAD frame.
        opening: of the jaws on the way in, in [m].
        rank: weighted sum of `terms`, larger is better.
        terms: score, height, upright, priority, clearance.
    """

    estimate: int
    point: GraspPoint
    T_world_tool: Array
    T_part_tool: Array
    opening: float
    rank: float
    terms: dict[str, float]


@dataclass(frozen=True)
class Selection:
    """Candidates, best first, and for every estimate how many poses of which grasp were ruled out by what.

    Attributes:
        ruled_out: estimate -> grasp name -> reason -> count; reasons are `avoided`, `tilt`, `gripper_bin`, `gripper_heap`,
            `outranked`.
    """

    candidates: list[GraspCandidate]
    ruled_out: dict[int, dict[str, dict[str, int]]] = field(default_factory=dict)


def select(
    Ts_world_part: Array,
    scores: Array,
    avoided: np.ndarray,
    poses: GraspPoses,
    workpiece: Workpiece,
    gripper: Gripper,
    bin: Bin,
    scene_points: Array,
    weights: Weights,
) -> Selection:
    """Candidates of all estimates, checked for room and ranked.

    Args:
        Ts_world_part: (k, 4, 4) estimated poses; scores: (k,) in [0, 1].
        avoided: (k,) bool: leave this estimate alone (a grasp on it failed lately).
        scene_points: (n, 3) measured points in the world, the bin's own excluded.
    """
    scene = thin(scene_points)
    heights = Ts_world_part[:, 2, 3] if len(Ts_world_part) else np.zeros(0)
    low, span = heights.min(initial=np.inf), max(float(np.ptp(heights)) if len(heights) else 0.0, 0.01)
    found: list[GraspCandidate] = []
    ruled_out: dict[int, dict[str, dict[str, int]]] = {}
    for k, T_world_part in enumerate(Ts_world_part):
        counts: dict[str, Counter[str]] = {}

        def note(which: np.ndarray, reason: str, counts: dict[str, Counter[str]] = counts) -> None:
            for i in poses.index[which]:
                counts.setdefault(poses.points[i].name, Counter())[reason] += 1

        everything = np.arange(len(poses.index))
        if avoided[k]:
            note(everything, "avoided")
        else:
            kept = _with_room(T_world_part, poses, workpiece, gripper, bin, scene, note)
            ranked = _rank(k, kept, T_world_part, float(scores[k]), (heights[k] - low) / span, poses, weights)
            found += ranked[:PER_ESTIMATE]
            for candidate in ranked[PER_ESTIMATE:]:
                counts.setdefault(candidate.point.name, Counter())["outranked"] += 1
        ruled_out[k] = {name: dict(c) for name, c in counts.items()}
    found.sort(key=lambda c: -c.rank)
    return Selection(found[: weights.max_candidates], ruled_out)


def _with_room(T_world_part, poses, workpiece, gripper, bin, scene, note):  # type: ignore[no-untyped-def]
    """Indices of the grasp poses with an upright approach and room for the open gripper."""
    Ts = T_world_part @ poses.Ts_part_tool
    upright = -Ts[:, 2, 2] > np.cos(MAX_TILT)
    note(np.flatnonzero(~upright), "tilt")
    alive = np.flatnonzero(upright)
    if len(alive) == 0:
        return alive
    boxes = {float(o): gripper.boxes(float(o)) for o in np.unique(poses.openings)}
    mine = [boxes[float(o)] for o in poses.openings[alive]]
    blocked = hits_bin(Ts[alive], mine, bin)
    note(alive[blocked], "gripper_bin")
    alive = alive[~blocked]
    if len(alive) == 0:
        return alive
    others = without_workpiece(scene, T_world_part, workpiece)
    count = points_in_gripper(Ts[alive], [boxes[float(o)] for o in poses.openings[alive]], others)
    note(alive[count > 0], "gripper_heap")
    return alive[count == 0]


def _rank(
    k: int, kept: np.ndarray, T_world_part: Array, score: float, height: float, poses: GraspPoses, weights: Weights
) -> list[GraspCandidate]:
    out = []
    for i in kept:
        T = T_world_part @ poses.Ts_part_tool[i]
        point = poses.points[poses.index[i]]
        terms = {
            "score": score,
            "height": float(height),
            "upright": float((-T[2, 2] - np.cos(MAX_TILT)) / (1 - np.cos(MAX_TILT))),
            "priority": point.priority,
            "clearance": 1.0 - 0.5 * min(int(poses.depth_rank[i]), 2) - 10.0 * float(poses.offset[i]),
        }
        rank = sum(getattr(weights, f"weight_{name}") * value for name, value in terms.items())
        out.append(GraspCandidate(k, point, T, poses.Ts_part_tool[i], float(poses.openings[i]), rank, terms))
    out.sort(key=lambda c: -c.rank)
    return out
