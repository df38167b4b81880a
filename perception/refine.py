"""The back half of perception: votes of the network to verified poses."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from cell.camera import DepthFrame
from cell.config import Config
from cell.frames import make_transform
from cell.workpiece import Workpiece
from perception.agreement import soft_score
from perception.calibration import ScoreModel
from perception.cluster import Categories, ClusterConfig, cluster, nearest_rotations
from perception.hypotheses import Hypotheses, HypothesisConfig, Places, best_of_each_place, find_places, propose
from perception.icp import COARSE, FINE, LAST, register
from perception.pose_estimate import PoseEstimate
from perception.shape_model import ShapeModel
from perception.surface_map import SurfaceMap
from perception.verify import VerifyConfig, claims, examine, inlier_tolerance, suppress
from perception.votes import Votes


class RefineConfig(Config):
    """Settings of the back half."""

    cluster: ClusterConfig = ClusterConfig()
    hypotheses: HypothesisConfig = HypothesisConfig()
    verify: VerifyConfig = VerifyConfig()
    keep_after_coarse: int = Field(3, ge=1, description="hypotheses of a place that go into fine ICP")
    depth_sigma: float = Field(1.2e-4, ge=0, description="[m] standard deviation of a measured depth")


@dataclass(frozen=True)
class RefineResult:
    """What was found in one depth image.

    Attributes:
        estimates: verified poses, best score first.
        raw: the two-stage clustering's poses before ICP (the paper's result), most votes first; their score is the
            share of votes that a category holds, and residual and visible share are unknown (NaN).
        seconds: wall time of each stage in [s].
    """

    estimates: list[PoseEstimate]
    raw: list[PoseEstimate]
    seconds: dict[str, float]


def refine(
    frame: DepthFrame,
    workpiece: Workpiece,
    votes: Votes,
    config: RefineConfig,
    roi: np.ndarray | None = None,
    score_model: ScoreModel | None = None,
) -> RefineResult:
    """Cluster votes, propose poses, register them to the depth image and keep what it confirms.

    Args:
        roi: (h, w) bool, where workpieces may be; None for everywhere.
        score_model: calibration of this workpiece; None for the default.
    """
    shape = ShapeModel.of(workpiece)
    clock = _Clock()
    votes = votes.finite()
    modes, categories = cluster(votes, shape, config.cluster)
    clock.lap("cluster")
    raw = _raw_estimates(categories, shape, len(votes))
    places = find_places(votes, modes, categories, config.hypotheses)
    if len(places.positions) == 0:
        return RefineResult([], raw, clock.seconds)
    with torch.no_grad():
        scene = SurfaceMap.of(frame, shape.unit, config.depth_sigma, roi)
        clustered = votes.select(places.of_vote >= 0)
        scene = scene.with_centres(clustered.points, clustered.centres)
        clock.lap("surface")
        hypotheses = propose(votes, modes, categories, places, scene, shape, config.hypotheses)
        clock.lap("hypotheses")
        hypotheses = _register(hypotheses, scene, shape, config)
        clock.lap("icp")
        estimates = _verify(hypotheses, votes, places, scene, shape, config, score_model or ScoreModel())
        clock.lap("verify")
    return RefineResult(estimates, raw, clock.seconds)


def _register(hypotheses: Hypotheses, scene: SurfaceMap, shape: ShapeModel, config: RefineConfig) -> Hypotheses:
    """Coarse ICP of all, fine ICP of the best of each place."""
    R, t = register(hypotheses.rotations, hypotheses.positions, scene, shape, COARSE)
    scores = soft_score(R, t, scene, shape, 128, 0.03).numpy()
    coarse = replace(hypotheses, rotations=R, positions=t, scores=scores)
    kept = coarse.select(best_of_each_place(coarse, shape, config.keep_after_coarse, 0.03))
    R, t = register(kept.rotations, kept.positions, scene, shape, FINE)
    return replace(kept, rotations=R, positions=t)


def _verify(
    hypotheses: Hypotheses,
    votes: Votes,
    places: Places,
    scene: SurfaceMap,
    shape: ShapeModel,
    config: RefineConfig,
    score_model: ScoreModel,
) -> list[PoseEstimate]:
    """Examine, settle rival claims, polish the winners and score them."""
    rules = config.verify
    first = examine(hypotheses.rotations, hypotheses.positions, scene, shape, rules)
    plausible = np.flatnonzero((first.ratio >= rules.min_ratio - 0.2) & (first.inliers >= rules.min_visible))
    if len(plausible) == 0:
        return []
    kept = hypotheses.select(plausible)
    R, t = register(kept.rotations, kept.positions, scene, shape, LAST)
    evidence = examine(R, t, scene, shape, rules, votes)
    scores = score_model.score(evidence.features(inlier_tolerance(scene, rules)))
    shared, overlap = claims(R, t, scene, shape, rules)
    order = np.argsort(-evidence.quality(), kind="stable")
    winners = np.asarray(suppress(order, shared, overlap, rules), dtype=np.int64)
    good = (scores >= rules.min_score) & (evidence.ratio >= rules.min_ratio) & (evidence.inliers >= rules.min_visible)
    winners = winners[good[winners]]
    return [
        PoseEstimate(
            T_camera_part=_transform(R[i], t[i], shape.unit),
            score=float(scores[i]),
            visible_share=float(evidence.inliers[i]),
            residual=float(evidence.residual[i] * shape.unit),
            n_votes=int(places.counts[kept.places[i]]),
        )
        for i in winners[np.argsort(-scores[winners], kind="stable")]
    ]


def _raw_estimates(categories: Categories, shape: ShapeModel, n_votes: int) -> list[PoseEstimate]:
    return [
        PoseEstimate(make_transform(R, t * shape.unit), float(count / max(n_votes, 1)), np.nan, np.nan, int(count))
        for R, t, count in zip(categories.rotations, categories.positions, categories.counts, strict=True)
    ]


def _transform(R: Tensor, t: Tensor, unit: float) -> np.ndarray:
    """T_camera_part in [m]; float32 rotations are made exact again."""
    return make_transform(nearest_rotations(R.double().numpy()[None])[0], t.double().numpy() * unit)


class _Clock:
    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage] = now - self._last
        self._last = now
