"""Everything after the network: votes to verified poses.

Takes a depth frame, the workpiece and its votes; gives a `RefineResult`: the poses of the clustering as they are (the
paper's result) and the poses that ICP and verification leave. docs/explanation/refinement.md has the steps in a table.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from pickproof.cell.frames import Array, make_transform
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.pose_estimate import PoseEstimate
from pickproof.perception.ps6d.pose_fitting import FitConfig, fit_categories
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import Categories, ClusterConfig, cluster, merge, nearest_rotations, vote
from pickproof.perception.refinement.config import RefineConfig
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.evidence import inlier_tolerance
from pickproof.perception.refinement.pose_search import Clustered, PoseSearch
from pickproof.perception.refinement.score_model import ScoreModel
from pickproof.perception.refinement.stage_clock import StageClock
from pickproof.perception.refinement.verify import Claims, accepted, on_surface, settle


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
        fitted: poses by all votes of a category, as `raw` otherwise; None where the settings do not ask for them, or
            the network predicts no CAD coordinates.
    """

    estimates: list[PoseEstimate]
    raw: list[PoseEstimate]
    seconds: dict[str, float]
    examined: Examined | None = None
    fitted: list[PoseEstimate] | None = None


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
    clock = StageClock()
    shape = ShapeModel.of(workpiece)
    clustered = cluster_votes(votes, shape, config.cluster)
    clock.lap("cluster")
    scene = measured_surface(frame, shape, config, roi)
    clock.lap("surface")
    return register_and_verify(clustered, scene, shape, config, score_model, clock)


def cluster_votes(votes: Votes, shape: ShapeModel, config: ClusterConfig) -> Clustered:
    """Two-stage clustering and pose voting of the paper; votes that are not finite are dropped."""
    votes = votes.finite()
    return Clustered(votes, *cluster(votes, shape, config))


def measured_surface(
    frame: DepthFrame, shape: ShapeModel, config: RefineConfig, roi: np.ndarray | None = None
) -> SurfaceMap:
    """The depth image as points and normals, in units; `roi` (h, w) bool limits where workpieces may be."""
    sigma = frame.sigma if config.depth_sigma is None else config.depth_sigma
    with torch.inference_mode():
        return SurfaceMap.of(frame, shape.unit, shape.deviation(sigma), roi)


def register_and_verify(
    clustered: Clustered,
    scene: SurfaceMap,
    shape: ShapeModel,
    config: RefineConfig,
    score_model: ScoreModel | None,
    clock: StageClock,
) -> RefineResult:
    """Hypotheses of the clusters through ICP and verification; `clock` has what came before, and takes the rest."""
    raw = _raw_estimates(clustered.categories, shape, len(clustered.votes))
    fitted = _fitted_estimates(clustered, shape, config.fit)
    if fitted is not None:
        clock.lap("fit")
    clustered = _places_of_every_mode(clustered, shape, config.cluster)
    with torch.inference_mode():
        search = PoseSearch(scene, shape, clustered.votes, config, score_model or ScoreModel(), clock)
        claims, standing = _search_twice(search, clustered)
        winners = accepted(claims, standing, config.verify, search.score_model.threshold)
        clock.lap("verify")
    features = claims.evidence.features(inlier_tolerance(scene, config.verify))
    examined = Examined(_transforms(claims, shape), features, claims.scores, standing)
    return RefineResult(_estimates(winners, shape), raw, clock.seconds, examined, fitted)


def _places_of_every_mode(clustered: Clustered, shape: ShapeModel, config: ClusterConfig) -> Clustered:
    """For slender parts every mode is a place: stage 2 joins neighbours on one line, whose folded positions agree."""
    if not shape.slender:
        return clustered
    modes = clustered.modes
    of_mode = merge(modes, modes.positions, config.model_copy(update={"two_stage": False}))
    return Clustered(clustered.votes, modes, vote(clustered.votes, modes, of_mode, shape))


def _search_twice(search: PoseSearch, clustered: Clustered) -> tuple[Claims, NDArray[np.int64]]:
    """Claims, and the indices (s,) of those without a better rival.

    What the accepted claims of the first search explain is done; the places among the votes left over get a second,
    longer search.
    """
    config, scene, shape = search.config, search.scene, search.shape
    claims = search.claims(clustered, config.hypotheses)
    standing = settle(claims, scene, shape, config.verify)
    if not config.second_round:
        return claims, standing
    winners = accepted(claims, standing, config.verify, search.score_model.threshold)
    left = clustered.votes.select(~on_surface(clustered.votes.points, winners, scene, shape, config.verify))
    search.clock.lap("verify")
    again = search.claims(Clustered.unclustered(left), config.hypotheses_second)
    if len(again) == 0:
        return claims, standing
    rivals = np.concatenate([standing, len(claims) + np.arange(len(again))])
    claims = claims.join(again)
    return claims, rivals[settle(claims.select(rivals), scene, shape, config.verify)]


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


def _fitted_estimates(clustered: Clustered, shape: ShapeModel, config: FitConfig | None) -> list[PoseEstimate] | None:
    votes = clustered.votes
    if config is None or votes.cad_coordinates is None:
        return None
    categories = fit_categories(votes, clustered.modes, clustered.categories, shape.symmetry, config)
    return _raw_estimates(categories, shape, len(votes))


def _raw_estimates(categories: Categories, shape: ShapeModel, n_votes: int) -> list[PoseEstimate]:
    return [
        PoseEstimate(make_transform(R, t * shape.unit), float(count / max(n_votes, 1)), np.nan, np.nan, int(count))
        for R, t, count in zip(categories.rotations, categories.positions, categories.counts, strict=True)
    ]


__all__ = [
    "Examined",
    "RefineConfig",
    "RefineResult",
    "cluster_votes",
    "measured_surface",
    "refine",
    "register_and_verify",
]
