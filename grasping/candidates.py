"""All pairs of estimate and grasp pose: each is ranked, or ruled out with its first reason.

Takes the estimated poses of a frame, the grasp poses of the workpiece and the measured heap; gives a `Selection`. The
checks of one estimate and the terms of the rank are in `grasping.estimate_checks`, the weights in `grasping.ranking`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.clearance import thin
from pickproof.grasping.estimate_checks import COVER_COUNTS, PER_ESTIMATE, Checked, Estimate, EstimateChecks
from pickproof.grasping.grasp_points import GraspPoint, GraspPoses
from pickproof.grasping.overlap import LIES, overlaps
from pickproof.grasping.ranking import GraspingConfig
from pickproof.grasping.verdict import Verdict

ESTIMATES_ENOUGH = 12
"""Number of workpieces with candidates after which estimates of lower preference are not checked."""
LEAST_SPAN = 0.01  # [m] smallest height range between the lowest and the highest estimate


@dataclass(frozen=True, eq=False)
class PartEstimates:
    """The estimates of perception in one frame.

    Attributes:
        Ts_world_part: (k, 4, 4) estimated poses; scores: (k,) in [0, 1].
        avoided: (k,) bool: skip this estimate (a grasp on it failed recently); None for none of them.
        errors: (k,) expected error of each pose in [m], compared with the tolerance of each grasp point; None for none.
    """

    Ts_world_part: Array
    scores: Array
    avoided: np.ndarray | None = None
    errors: Array | None = None

    @cached_property
    def above_lowest(self) -> Array:
        """(k,) [m] height of each estimate over the lowest one."""
        z = self.Ts_world_part[:, 2, 3]
        return np.asarray(z - z.min(initial=np.inf))

    @property
    def span(self) -> float:
        """[m] from the lowest estimate to the highest, LEAST_SPAN at least."""
        return max(float(self.above_lowest.max(initial=0.0)), LEAST_SPAN)


@dataclass(frozen=True, eq=False)
class PickScene:
    """The scene of the gripper: workpieces of one kind in a bin.

    Attributes:
        scene_points: (m, 3) measured points in the world, the bin's own excluded.
    """

    workpiece: Workpiece
    gripper: Gripper
    bin: Bin
    scene_points: Array


@dataclass(frozen=True)
class GraspCandidate:
    """One grasp of one estimated workpiece.

    Attributes:
        estimate: index of the estimate.
        point: the grasp point.
        T_world_tool: (4, 4) TCP at the grasp; T_part_tool: the same in the CAD frame.
        opening: of the jaws during the approach, in [m].
        rank: weighted sum of `terms`, larger is better.
        terms: name -> value in [0, 1], see `grasping.ranking`.
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
    """Candidates, best first, and for every estimate the number of poses of each grasp ruled out by each reason.

    Attributes:
        ruled_out: estimate -> grasp name -> verdict -> count.
        verdicts: estimate -> (n,) verdict on each of the grasp poses, empty for a candidate.
    """

    candidates: list[GraspCandidate]
    ruled_out: dict[int, dict[str, dict[str, int]]] = field(default_factory=dict)
    verdicts: dict[int, np.ndarray] = field(default_factory=dict)


def select(estimates: PartEstimates, poses: GraspPoses, scene: PickScene, weights: GraspingConfig) -> Selection:
    """Candidates of all estimates, checked for clearance and ranked; preferred estimates are checked first."""
    points = thin(scene.scene_points)
    checks = EstimateChecks.of(poses, scene.workpiece, scene.gripper, scene.bin, points, weights)
    hooked = _hooked(estimates, scene.workpiece, weights)
    checked: dict[int, Checked] = {}
    pickable = 0
    for k in _most_wanted_first(estimates, weights):
        stop = _left_alone(estimates, k, weights)
        if stop is None and pickable >= ESTIMATES_ENOUGH:
            stop = Verdict.OUTRANKED
        checked[k] = checks.all_ruled_out(stop) if stop else checks.check(_estimate(estimates, k, hooked))
        pickable += bool(checked[k].kept)
    found = [c for k, own in checked.items() for c in _candidates(k, own, poses, weights)]
    found.sort(key=lambda c: -c.rank)
    ruled_out = {k: _counted(own.verdicts, poses) for k, own in checked.items()}
    for candidate in found[weights.max_candidates :]:
        of_point = ruled_out[candidate.estimate].setdefault(candidate.point.name, {})
        of_point[str(Verdict.OUTRANKED)] = of_point.get(str(Verdict.OUTRANKED), 0) + 1
    verdicts = {k: own.verdicts for k, own in checked.items()}
    return Selection(found[: weights.max_candidates], ruled_out, verdicts)


def _most_wanted_first(estimates: PartEstimates, weights: GraspingConfig) -> list[int]:
    """Indices of the estimates by falling score and height."""
    of_height = weights.weight_height * estimates.above_lowest / estimates.span
    wanted = weights.weight_score * np.asarray(estimates.scores) + of_height
    return [int(k) for k in np.argsort(-wanted, kind="stable")]


def _left_alone(estimates: PartEstimates, k: int, weights: GraspingConfig) -> Verdict | None:
    """The reason why estimate k is not checked at all; None where it is checked."""
    if estimates.scores[k] < weights.min_score:
        return Verdict.SCORE
    if estimates.avoided is not None and estimates.avoided[k]:
        return Verdict.AVOIDED
    return None


def _hooked(estimates: PartEstimates, workpiece: Workpiece, weights: GraspingConfig) -> np.ndarray:
    """(k,) bool: more of the estimate than allowed lies under another estimate with a sufficient score."""
    if weights.max_overlap_mm2 is None:
        return np.zeros(len(estimates.Ts_world_part), dtype=bool)
    under = overlaps(workpiece, estimates.Ts_world_part, np.asarray(estimates.scores) >= LIES)
    return np.asarray(under > 1e-6 * weights.max_overlap_mm2)


def _estimate(estimates: PartEstimates, k: int, hooked: np.ndarray) -> Estimate:
    error = 0.0 if estimates.errors is None else float(estimates.errors[k])
    height, score = float(estimates.above_lowest[k] / estimates.span), float(estimates.scores[k])
    return Estimate(estimates.Ts_world_part[k], score, height, error, bool(hooked[k]))


def _candidates(k: int, checked: Checked, poses: GraspPoses, weights: GraspingConfig) -> list[GraspCandidate]:
    """The kept poses of estimate k as candidates."""
    return [
        GraspCandidate(
            estimate=k,
            point=poses.points[poses.index[i]],
            T_world_tool=T_world_tool,
            T_part_tool=poses.Ts_part_tool[i],
            opening=float(poses.openings[i]),
            rank=float(weights.rank(terms)),
            terms=terms,
        )
        for i, T_world_tool, terms in zip(checked.kept, checked.Ts_world_tool, checked.terms, strict=True)
    ]


def _counted(verdicts: np.ndarray, poses: GraspPoses) -> dict[str, dict[str, int]]:
    """Grasp name -> verdict -> number of poses ruled out, including poses that were not expanded."""
    counts = {name: Counter({str(Verdict.DISABLED): n}) for name, n in poses.disabled.items()}
    for name, n in poses.no_place.items():
        counts.setdefault(name, Counter())[str(Verdict.NO_PLACE)] += n
    for said in np.unique(verdicts[verdicts != ""]):
        of_points = np.bincount(poses.index[verdicts == said], minlength=len(poses.points))
        for point, n in zip(poses.points, of_points.tolist(), strict=True):
            if n:
                counts.setdefault(point.name, Counter())[str(said)] += n
    return {name: dict(c) for name, c in counts.items()}


__all__ = ["COVER_COUNTS", "PER_ESTIMATE", "GraspCandidate", "PartEstimates", "PickScene", "Selection", "select"]
