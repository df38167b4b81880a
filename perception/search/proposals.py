"""Poses that a network's votes propose, to be decided about together with those of the search."""

from __future__ import annotations

from dataclasses import dataclass

from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import cluster
from pickproof.perception.refinement.config import RefineConfig
from pickproof.perception.refinement.hypotheses import propose
from pickproof.perception.refinement.icp import COARSE, register
from pickproof.perception.refinement.places import find_places
from pickproof.perception.search.candidates import Candidates
from pickproof.perception.search.poses import Poses
from pickproof.perception.search.scene import Scene


@dataclass(frozen=True)
class Proposals:
    """A network's word on a frame: its votes, and the settings with which poses are made of them."""

    votes: Votes
    config: RefineConfig

    def poses(self, scene: Scene, candidates: Candidates) -> Poses:
        """Poses of the clusters, registered coarsely and scored as those of the search."""
        votes, shape = self.votes.finite(), candidates.shape
        if not len(votes):
            return Poses.none()
        modes, categories = cluster(votes, shape, self.config.cluster)
        settings = self.config.hypotheses.of(shape)
        places = find_places(votes, modes, categories, shape, settings)
        near = votes.select(places.of_vote >= 0)
        if not len(near):
            return Poses.none()
        voted = scene.surface.with_centres(near.points, near.centres)
        proposed = propose(votes, modes, categories, places, voted, shape, settings)
        R, t = register(proposed.rotations, proposed.positions, voted, shape, COARSE)
        return Poses(R, t, candidates.coarse_scores(R, t, scene))
