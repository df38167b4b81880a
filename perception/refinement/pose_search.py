"""One search for poses: hypotheses, ICP in three stages, and the evidence for what is left.

Takes votes with their clusters and the measured surface; gives `Claims`, examined poses with calibrated scores, before
rivals are settled. Each step can be called alone: whoever has hypotheses from elsewhere starts at `registered`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from torch import Tensor

from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import Categories, Modes
from pickproof.perception.refinement.config import HypothesisConfig, RefineConfig
from pickproof.perception.refinement.depth_agreement import soft_score
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.evidence import examine, inlier_tolerance
from pickproof.perception.refinement.hypotheses import propose
from pickproof.perception.refinement.hypothesis_set import Hypotheses, best_of_each_place, distinct
from pickproof.perception.refinement.icp import COARSE, FINE, LAST, register
from pickproof.perception.refinement.places import find_places
from pickproof.perception.refinement.score_model import ScoreModel
from pickproof.perception.refinement.stage_clock import StageClock
from pickproof.perception.refinement.verify import Claims


@dataclass(frozen=True)
class Clustered:
    """Votes that are searched, with the result of clustering them.

    Attributes:
        votes: m votes; modes: of stage 1; categories: of stage 2. Where a search does without clusters these are empty
            and places come from the predicted centres alone.
    """

    votes: Votes
    modes: Modes
    categories: Categories

    @staticmethod
    def unclustered(votes: Votes) -> Clustered:
        """Votes without clusters."""
        return Clustered(votes, Modes.none(len(votes)), Categories.none())


@dataclass(frozen=True)
class PoseSearch:
    """What hypotheses are compared with, and the settings of the comparison.

    Attributes:
        scene: the measured surface; shape: of the workpiece.
        every_vote: all votes of the frame, which support a pose wherever it was found.
        config: thresholds; score_model: calibration of the score.
        clock: adds up the wall time of the stages `hypotheses`, `icp` and `verify`.
    """

    scene: SurfaceMap
    shape: ShapeModel
    every_vote: Votes
    config: RefineConfig
    score_model: ScoreModel
    clock: StageClock

    def claims(self, clustered: Clustered, settings: HypothesisConfig) -> Claims:
        """Poses found from `clustered` and examined."""
        settings = settings.of(self.shape)
        places = find_places(clustered.votes, clustered.modes, clustered.categories, self.shape, settings)
        near = clustered.votes.select(places.of_vote >= 0)
        with_votes = replace(self, scene=self.scene.with_centres(near.points, near.centres))
        proposed = propose(
            clustered.votes, clustered.modes, clustered.categories, places, with_votes.scene, self.shape, settings
        )
        self.clock.lap("hypotheses")
        R, t = with_votes.registered(proposed, settings.keep_after_coarse)
        self.clock.lap("icp")
        found = with_votes.examined(R, t)
        self.clock.lap("verify")
        return found

    def registered(self, hypotheses: Hypotheses, keep: int) -> tuple[Tensor, Tensor]:
        """Rotations (h, 3, 3) and positions (h, 3) after coarse ICP, for `keep` of each place, and fine ICP."""
        rules, scene, shape = self.config.registration, self.scene, self.shape
        R, t = register(hypotheses.rotations, hypotheses.positions, scene, shape, COARSE)
        tolerance = rules.coarse_tolerance * shape.fineness
        scores = soft_score(R, t, scene, shape, rules.coarse_points, tolerance).numpy()
        coarse = replace(hypotheses, rotations=R, positions=t, scores=scores)
        kept = coarse.select(best_of_each_place(coarse, shape, keep, rules.apart_in_place))
        kept = kept.select(distinct(kept.rotations, kept.positions, kept.scores, shape, rules.apart_after_coarse))
        return register(kept.rotations, kept.positions, scene, shape, FINE)

    def examined(self, R: Tensor, t: Tensor) -> Claims:
        """The plausible ones of poses R (h, 3, 3), t (h, 3) after the last ICP, with evidence and score."""
        rules, verify, scene, shape = self.config.registration, self.config.verify, self.scene, self.shape
        first = examine(R, t, scene, shape, verify, every=rules.screen_every)
        good = (first.ratio >= verify.min_ratio - rules.screen_slack) & (first.inliers >= verify.min_visible)
        plausible = np.flatnonzero(good)
        i = plausible[distinct(R[plausible], t[plausible], first.area[plausible], shape, rules.apart_after_fine)]
        R, t = register(R[i], t[i], scene, shape, LAST)
        evidence = examine(R, t, scene, shape, verify, self.every_vote)
        scores = self.score_model.score(evidence.features(inlier_tolerance(scene, verify)))
        return Claims(R, t, evidence, scores)
