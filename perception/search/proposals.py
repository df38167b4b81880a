"""Poses that a network's votes propose, to be decided about together with those of the search."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import cluster
from pickproof.perception.refinement.depth_agreement import soft_score
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.hypotheses import find_places, propose
from pickproof.perception.refinement.icp import COARSE, register
from pickproof.perception.refinement.refine import RefineConfig
from pickproof.perception.search.poses import Poses


@dataclass(frozen=True)
class Proposals:
    """A network's word on a frame: its votes, and the settings with which poses are made of them."""

    votes: Votes
    config: RefineConfig

    def poses(self, surface: SurfaceMap, shape: ShapeModel, score_points: int, tolerance: float) -> Poses:
        """Registered coarsely; scores are `soft_score` with that many points at `tolerance` units."""
        votes = self.votes.finite()
        if not len(votes):
            return Poses.none()
        modes, categories = cluster(votes, shape, self.config.cluster)
        settings = self.config.hypotheses.of(shape)
        with torch.inference_mode():
            places = find_places(votes, modes, categories, shape, settings)
            near = votes.select(places.of_vote >= 0)
            if not len(near):
                return Poses.none()
            voted = surface.with_centres(near.points, near.centres)
            proposed = propose(votes, modes, categories, places, voted, shape, settings)
            R, t = register(proposed.rotations, proposed.positions, voted, shape, COARSE)
            return Poses(R, t, soft_score(R, t, surface, shape, score_points, tolerance).numpy())
