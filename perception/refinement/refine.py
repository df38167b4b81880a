"""The back half of perception: votes of the network to verified poses."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from pickproof.cell.config import Config, Sigma
from pickproof.cell.frames import Array, make_transform
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.pose_estimate import PoseEstimate
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import Categories, ClusterConfig, Modes, cluster, merge, nearest_rotations, vote
from pickproof.perception.refinement.depth_agreement import soft_score
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.hypotheses import (
    HypothesisConfig,
    best_of_each_place,
    distinct,
    find_places,
    propose,
)
from pickproof.perception.refinement.icp import COARSE, FINE, LAST, register
from pickproof.perception.refinement.score_model import ScoreModel
from pickproof.perception.refinement.verify import (
    Claims,
    VerifyConfig,
    accepted,
    examine,
    inlier_tolerance,
    on_surface,
    settle,
)


class RefineConfig(Config):
    """Settings of the back half."""

    cluster: ClusterConfig = ClusterConfig()
    hypotheses: HypothesisConfig = HypothesisConfig()
    verify: VerifyConfig = VerifyConfig()
    second_round: bool = Field(True, description="search again among the votes that no accepted pose explains")
    hypotheses_second: HypothesisConfig = HypothesisConfig(votes_per_place=24, keep=4, max_places=8, min_votes_place=5)
    depth_sigma: Sigma | None = Field(
        None, description="[m] standard deviation of a measured depth; none: what the frame says"
    )


@dataclass(frozen=True)
class Examined:
    """Every pose that verification examined, right or wrong, before rivals were settled.

    Attributes:
        Ts_camera_part: (h, 4, 4) in [m].
        features: (h, len(FEATURES)), inputs of the score model.
        scores: (h,) in [0, 1].
        standing: (s,) indices of those that have no better rival, best first; thresholds come after.
    """

    Ts_camera_part: Array
    features: Array
    scores: Array
    standing: NDArray[np.int64]


@dataclass(frozen=True)
class RefineResult:
    """What was found in one depth image.

    Attributes:
        estimates: verified poses, best score first.
        raw: the two-stage clustering's poses before ICP (the paper's result), most votes first; their score is the
            share of votes that a category holds, and residual and visible share are unknown (NaN).
        seconds: wall time of each stage in [s].
        examined: what the score is calibrated on; None without votes.
    """

    estimates: list[PoseEstimate]
    raw: list[PoseEstimate]
    seconds: dict[str, float]
    examined: Examined | None = None


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
    score_model = score_model or ScoreModel()
    clock = _Clock()
    votes = votes.finite()
    modes, categories = cluster(votes, shape, config.cluster)
    raw = _raw_estimates(categories, shape, len(votes))
    if shape.slender:  # folded positions of neighbours on one line agree, so stage 2 joins them: every mode is a place
        single = config.cluster.model_copy(update={"two_stage": False})
        categories = vote(votes, modes, merge(modes, modes.positions, single), shape)
    clock.lap("cluster")
    with torch.inference_mode():
        sigma = frame.sigma if config.depth_sigma is None else config.depth_sigma
        scene = SurfaceMap.of(frame, shape.unit, sigma, roi)
        clock.lap("surface")
        claims = _search(votes, votes, modes, categories, scene, shape, config, config.hypotheses, score_model, clock)
        standing = settle(claims, scene, shape, config.verify)
        winners = accepted(claims, standing, config.verify, score_model.threshold)
        clock.lap("verify")
        if config.second_round:
            # what the winners explain is done; each place among the votes left over gets a longer search
            left = votes.select(~on_surface(votes.points, winners, scene, shape, config.verify))
            nothing = Modes.none(len(left)), Categories.none()
            again = _search(left, votes, *nothing, scene, shape, config, config.hypotheses_second, score_model, clock)
            if len(again):
                rivals = np.concatenate([standing, len(claims) + np.arange(len(again))])
                claims = claims.join(again)
                standing = rivals[settle(claims.select(rivals), scene, shape, config.verify)]
                winners = accepted(claims, standing, config.verify, score_model.threshold)
            clock.lap("verify")
    features = claims.evidence.features(inlier_tolerance(scene, config.verify))
    examined = Examined(_transforms(claims, shape), features, claims.scores, standing)
    return RefineResult(_estimates(winners, shape), raw, clock.seconds, examined)


def _search(
    votes: Votes,
    every_vote: Votes,
    modes: Modes,
    categories: Categories,
    scene: SurfaceMap,
    shape: ShapeModel,
    config: RefineConfig,
    search: HypothesisConfig,
    score_model: ScoreModel,
    clock: _Clock,
) -> Claims:
    """Hypotheses from `votes`, registered to the depth image and examined."""
    search = search.of(shape)
    places = find_places(votes, modes, categories, shape, search)
    near = votes.select(places.of_vote >= 0)
    scene = scene.with_centres(near.points, near.centres)
    proposed = propose(votes, modes, categories, places, scene, shape, search)
    clock.lap("hypotheses")
    R, t = register(proposed.rotations, proposed.positions, scene, shape, COARSE)
    coarse = replace(
        proposed, rotations=R, positions=t, scores=soft_score(R, t, scene, shape, 128, 0.03 * shape.fineness).numpy()
    )
    kept = coarse.select(best_of_each_place(coarse, shape, search.keep_after_coarse, 0.03))
    kept = kept.select(distinct(kept.rotations, kept.positions, kept.scores, shape, 0.02))
    R, t = register(kept.rotations, kept.positions, scene, shape, FINE)
    clock.lap("icp")
    rules = config.verify
    first = examine(R, t, scene, shape, rules, every=2)
    plausible = np.flatnonzero((first.ratio >= rules.min_ratio - 0.2) & (first.inliers >= rules.min_visible))
    i = plausible[distinct(R[plausible], t[plausible], first.area[plausible], shape, 0.01)]
    R, t = register(R[i], t[i], scene, shape, LAST)
    evidence = examine(R, t, scene, shape, rules, every_vote)
    scores = score_model.score(evidence.features(inlier_tolerance(scene, rules)))
    clock.lap("verify")
    return Claims(R, t, evidence, scores)


def _estimates(claims: Claims, shape: ShapeModel) -> list[PoseEstimate]:
    T = _transforms(claims, shape)
    return [
        PoseEstimate(
            T_camera_part=T[i].copy(),
            score=float(claims.scores[i]),
            visible_share=float(claims.evidence.inliers[i]),
            residual=float(claims.evidence.residual[i] * shape.unit),
            n_votes=int(claims.evidence.votes[i]),
        )
        for i in range(len(claims))
    ]


def _transforms(claims: Claims, shape: ShapeModel) -> Array:
    R = nearest_rotations(claims.rotations.double().numpy())
    return make_transform(R, claims.positions.double().numpy() * shape.unit)


def _raw_estimates(categories: Categories, shape: ShapeModel, n_votes: int) -> list[PoseEstimate]:
    return [
        PoseEstimate(make_transform(R, t * shape.unit), float(count / max(n_votes, 1)), np.nan, np.nan, int(count))
        for R, t, count in zip(categories.rotations, categories.positions, categories.counts, strict=True)
    ]


class _Clock:
    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self._last = now
