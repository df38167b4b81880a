"""Any CAD part in a depth image, without training.

Seeds, search, coarse ICP, coverage, fine ICP, rough examination, last ICP, full examination, two decisions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from pickproof.cell.geometry.bin import Bin
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.refine import RefineResult
from pickproof.perception.refinement.stage_clock import StageClock
from pickproof.perception.search.cad_table import CadTable
from pickproof.perception.search.candidates import Candidates
from pickproof.perception.search.config import SearchConfig
from pickproof.perception.search.decision import ALONE, Decisions
from pickproof.perception.search.proposals import Proposals
from pickproof.perception.search.scene import Scene
from pickproof.perception.search.seeds import SeedPixels
from pickproof.perception.search.settling import Settling


@dataclass(frozen=True)
class Search:
    """The search for one workpiece; a frame in, verified poses out."""

    shape: ShapeModel
    config: SearchConfig
    candidates: Candidates
    settling: Settling

    @staticmethod
    def of(workpiece: Workpiece, config: SearchConfig | None = None, decisions: Decisions = ALONE) -> Search:
        """Ready to search (some seconds, once a workpiece and process)."""
        config = config or SearchConfig.model_validate({})
        shape, table = ShapeModel.of(workpiece), CadTable.of(workpiece, config)
        return Search(shape, config, Candidates(shape, table, config), Settling(shape, config, decisions))

    @torch.inference_mode()
    def find(
        self,
        frame: DepthFrame,
        region: np.ndarray,
        bin: Bin | None,
        rng: np.random.Generator,
        network: Proposals | None = None,
    ) -> RefineResult:
        """Verified poses in a frame.

        Args:
            region: (h, w) bool, pixels that may show workpieces.
            bin: that holds them; None where none is known.
            rng: chooses the seeds.
            network: what a network says of the frame; its poses are looked at beside those of the search.
        """
        clock = StageClock()
        sigma = frame.sigma if self.config.depth_sigma is None else self.config.depth_sigma
        surface = SurfaceMap.of(frame, self.shape.unit, self.shape.deviation(sigma), region)
        pixels = SeedPixels(surface)
        points = pixels.one_a_voxel(self.config.vote_voxel, rng)
        seeds = pixels.one_a_voxel(self.config.voxel, rng, self.config.least_seeds, self.candidates.most_seeds)
        scene = Scene(frame, bin, surface, points, None if network is None else network.votes.finite())
        clock.lap("surface")
        poses = self.candidates.at_seeds(seeds, scene)
        clock.lap("search")
        poses = self.candidates.registered_coarsely(poses, scene)
        clock.lap("coarse")
        if network is not None:
            poses = self.candidates.plausible(poses.join(network.poses(scene, self.candidates)))
            clock.lap("hypotheses")
        poses = self.candidates.registered_finely(poses, scene)
        clock.lap("icp")
        result = self.settling.result(poses, scene)
        clock.lap("verify")
        return replace(result, seconds=clock.seconds)
