"""Perception of one depth frame; `Perception.perceive_region` reads as the paper's pipeline (PS6D, sec. III).

Takes a depth frame and the region of workpieces; gives a `RefineResult`: the paper's poses, and those after ICP and
verification. Without weights the search takes the place of the network; with both, the network proposes poses beside
the search's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from pickproof.cell.geometry.bin import Bin
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.method import Method
from pickproof.perception.pose_estimate import PoseEstimate
from pickproof.perception.ps6d.allocator import keep_freed_memory
from pickproof.perception.ps6d.cloud import Cloud, roi_mask, scene_cloud
from pickproof.perception.ps6d.network import Ps6d, pack
from pickproof.perception.ps6d.point_hierarchy import build_levels, input_points, top_neighbours
from pickproof.perception.ps6d.variants import cluster_config
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.weights import load_weights, weights_path
from pickproof.perception.refinement.config import RefineConfig
from pickproof.perception.refinement.refine import (
    RefineResult,
    cluster_votes,
    measured_surface,
    register_and_verify,
)
from pickproof.perception.refinement.score_model import ScoreModel, score_path
from pickproof.perception.refinement.stage_clock import StageClock
from pickproof.perception.search.config import SearchConfig
from pickproof.perception.search.decision import ALONE, WITH_NETWORK
from pickproof.perception.search.proposals import Proposals
from pickproof.perception.search.search import Search

PASSES, PASSES_SLENDER = 2, 3
"""Samplings of the cloud that vote together: each adds votes on other points at the cost of one forward pass. Slender
workpieces, whose ends few points see, gain by one more."""


@dataclass(frozen=True)
class Perception:
    """PS6D with refinement, the search or both for one workpiece; a frame in, verified poses out.

    Attributes:
        network: None where only the search looks.
        passes: samplings of the cloud that vote.
        search: None where only the network looks.
    """

    workpiece: Workpiece
    network: Ps6d | None
    config: RefineConfig
    score_model: ScoreModel | None
    passes: int = PASSES
    search: Search | None = None

    @staticmethod
    def load(
        workpiece: Workpiece,
        weights: Path | None = None,
        config: RefineConfig | None = None,
        calibrated: bool = True,
        method: Method = "auto",
    ) -> Perception:
        """With the shipped weights, or those of a file; `calibrated` takes the workpiece's own score model.

        Raises:
            InputError: missing or corrupt weights, or a corrupt score model.
        """
        torch.set_num_threads(1)  # more do not help at this size, and workers run side by side
        keep_freed_memory()
        ShapeModel.of(workpiece)  # built once a process: some seconds that belong to no frame
        config = config or RefineConfig.model_validate({})
        chosen = method_for(workpiece, method, weights)
        search = None
        if chosen != "ps6d":
            settings = SearchConfig.model_validate({})
            rules = settings.verify.model_copy(update={"min_score": config.verify.min_score})
            settings = settings.model_copy(update={"verify": rules, "depth_sigma": config.depth_sigma})
            search = Search.of(workpiece, settings, ALONE if chosen == "search" else WITH_NETWORK)
        if chosen == "search":
            return Perception(workpiece, None, config, None, search=search)
        network = load_weights(weights or weights_path(workpiece), workpiece)
        score_model = shipped_score_model(workpiece) if calibrated else None
        config = config.model_copy(update={"cluster": cluster_config(network.config, config.cluster)})
        passes = PASSES_SLENDER if workpiece.units_long > 1 else PASSES
        return Perception(workpiece, network, config, score_model, passes, search)

    def perceive(self, frame: DepthFrame, bin: Bin, rng: np.random.Generator) -> RefineResult:
        """Verified estimates and the network's raw poses; `rng` chooses the voting points and the seeds."""
        return self.perceive_region(frame, roi_mask(frame, bin), rng, bin)

    def perceive_region(
        self, frame: DepthFrame, mask: np.ndarray, rng: np.random.Generator, bin: Bin | None = None
    ) -> RefineResult:
        """The pipeline of the paper, then ours, where `mask` (h, w) bool says where workpieces may be.

        `bin`, where one is known, holds the workpieces.
        """
        if self.network is None:
            assert self.search is not None  # load
            return self.search.find(frame, mask, bin, rng)
        clock, shape = StageClock(), ShapeModel.of(self.workpiece)

        # Workpiece normalisation: the cloud in units of the workpiece, about its mean
        cloud = scene_cloud(frame, mask, self.workpiece.unit)

        # Network: attention-guided features, then centre and rotation of the workpiece under every voting point
        votes = self.vote(cloud, rng)
        clock.lap("network")
        if votes is None:
            return RefineResult([], [], clock.seconds)
        if self.search is not None:
            result = self.search.find(frame, mask, bin, rng, Proposals(votes, self.config))
            return replace(result, seconds=clock.seconds | result.seconds)

        # Two-stage clustering and pose voting: one pose for every category. This is the paper's result
        clustered = cluster_votes(votes, shape, self.config.cluster)
        clock.lap("cluster")

        # Ours: hypotheses from the clusters, ICP against the depth image, verification of what it leaves
        surface = measured_surface(frame, shape, self.config, mask)
        clock.lap("surface")
        return register_and_verify(clustered, surface, shape, self.config, self.score_model, clock)

    @torch.inference_mode()
    def vote(self, cloud: Cloud, rng: np.random.Generator) -> Votes | None:
        """One pose vote for every voting point of every pass, in normalised camera coordinates; None without points."""
        assert self.network is not None  # a search alone has no votes
        level0 = input_points(cloud, rng)
        if level0 is None:
            return None
        graphs = [build_levels(level0, rng, top_neighbours(self.workpiece)) for _ in range(self.passes)]
        prediction = self.network(pack(graphs))
        origin = cloud.origin / cloud.unit
        points = np.concatenate([g.levels[0].points for g in graphs])
        return Votes(
            points + origin,
            prediction.centres.numpy() + origin,
            prediction.rotations.numpy().astype(np.float64),
            prediction.cad.numpy() if prediction.cad is not None else None,
            prediction.confidence.sigmoid().numpy() if prediction.confidence is not None else None,
        )


def method_for(workpiece: Workpiece, method: Method, weights: Path | None = None) -> Method:
    """ps6d, search or both: what `auto` comes to for a workpiece, given its weights or those of a file."""
    if method != "auto":
        return method
    return "ps6d" if weights is not None or weights_path(workpiece).is_file() else "search"


def shipped_score_model(workpiece: Workpiece) -> ScoreModel | None:
    """The calibration that `pickproof fit-score` left beside the workpiece; None where it has none.

    Raises:
        InputError: the file is corrupt or of other features.
    """
    path = score_path(workpiece)
    return ScoreModel.load(path) if path.is_file() else None


__all__ = ["Perception", "PoseEstimate", "RefineResult", "method_for"]
