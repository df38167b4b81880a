"""From some hundred poses to the result: rough examination, last ICP, full examination, two decisions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pickproof.cell.frames import Array, make_transform
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.pose_estimate import PoseEstimate
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import nearest_rotations
from pickproof.perception.refinement.evidence import Evidence, examine, inlier_tolerance, vote_support
from pickproof.perception.refinement.icp import LAST, register
from pickproof.perception.refinement.refine import Examined, RefineResult
from pickproof.perception.refinement.rivalry import rivalry, suppress
from pickproof.perception.search.config import SearchConfig
from pickproof.perception.search.coverage import kept_by_points, poses_at
from pickproof.perception.search.decision import Decisions, features_of, with_votes
from pickproof.perception.search.outside import outside
from pickproof.perception.search.poses import Poses
from pickproof.perception.search.scene import Scene

ROUGH = 3
"""The rough examination looks at one point in so many."""
CLAIM_REACH = 0.7
"""Factor of the reach once poses are fine."""
LAST_APART = 0.01
STRIDE, STRIDE_ROUGH = 5, 10
"""One surface sample in so many says how much lies outside the bin."""


@dataclass(frozen=True)
class Looked:
    """Poses with what the depth image says of them.

    Attributes:
        poses: h of them; their scores are the log odds of the order.
        evidence: of verification.
        features: (h, len(FEATURES)), inputs of the decisions.
    """

    poses: Poses
    evidence: Evidence
    features: Array

    def select(self, index: np.ndarray) -> Looked:
        """Those at `index`."""
        return Looked(self.poses.select(index), self.evidence.select(index), self.features[index])


@dataclass(frozen=True)
class Settling:
    """The last steps for one workpiece."""

    shape: ShapeModel
    config: SearchConfig
    decisions: Decisions

    def result(self, poses: Poses, scene: Scene) -> RefineResult:
        """The accepted ones of finely registered poses."""
        poses = self._worth_a_last_step(poses, scene)
        if not len(poses):
            return RefineResult([], [], {})
        R, t = register(poses.rotations, poses.positions, scene.surface, self.shape, LAST)
        looked = self._look(Poses(R, t, poses.scores), scene)
        looked = looked.select(looked.poses.distinct_index(self.shape, LAST_APART))
        poses, rules = looked.poses, self.config.verify
        shared, overlap = rivalry(poses.rotations, poses.positions, scene.surface, self.shape, rules)
        standing = np.asarray(suppress(np.arange(len(poses)), shared, overlap, rules), dtype=np.int64)
        if scene.votes is None:
            looked = self._with_own_votes(looked, scene)
        return self._accepted(looked, standing)

    def _worth_a_last_step(self, poses: Poses, scene: Scene) -> Poses:
        """After a rough look: plausible poses, those that some point keeps."""
        if not len(poses):
            return poses
        rules = self.config.verify
        looked = self._look(poses, scene, ROUGH)
        found = looked.evidence
        plausible = (found.ratio >= self.config.least_ratio) & (found.inliers >= rules.min_visible)
        i = np.flatnonzero(plausible)
        poses = looked.poses.select(i[np.argsort(-looked.poses.scores[i], kind="stable")])
        at = poses_at(scene.points, poses, self.shape, CLAIM_REACH * self.config.reach, self.config.claims_per_point)
        return poses.select(kept_by_points(at))

    def _look(self, poses: Poses, scene: Scene, every: int = 1) -> Looked:
        R, t, rules, surface = poses.rotations, poses.positions, self.config.verify, scene.surface
        evidence = examine(R, t, surface, self.shape, rules, scene.votes, every)
        beyond = outside(R, t, self.shape, scene.frame, scene.bin, STRIDE if every == 1 else STRIDE_ROUGH)
        tolerance = inlier_tolerance(surface, rules)
        features = features_of(evidence, beyond, tolerance)
        return Looked(replace(poses, scores=self.decisions.order.log_odds(features)), evidence, features)

    def _with_own_votes(self, looked: Looked, scene: Scene) -> Looked:
        """Every point votes for the best pose that it lies on."""
        poses, shape = looked.poses, self.shape
        at = poses_at(scene.points, poses, shape, CLAIM_REACH * self.config.reach, 1)[:, 0]
        R, t = poses.rotations.numpy().astype(np.float64), poses.positions.numpy().astype(np.float64)
        voting = at >= 0
        votes = Votes(scene.points.points[voting].astype(np.float64), t[at[voting]], R[at[voting]])
        tolerance = 2 * inlier_tolerance(scene.surface, self.config.verify)
        counts, centres, rotations = vote_support(poses.rotations, poses.positions, shape, tolerance, votes)
        evidence = replace(looked.evidence, votes=counts, centres_agree=centres, rotations_agree=rotations)
        return Looked(poses, evidence, with_votes(looked.features, evidence))

    def _accepted(self, looked: Looked, standing: np.ndarray) -> RefineResult:
        rules, evidence = self.config.verify, looked.evidence
        scores = self.decisions.acceptance.score(looked.features)
        R = nearest_rotations(looked.poses.rotations.double().numpy())
        Ts = make_transform(R, looked.poses.positions.double().numpy() * self.shape.unit)
        least = self.decisions.threshold if rules.min_score is None else rules.min_score
        good = (scores >= least) & (evidence.ratio >= rules.min_ratio) & (evidence.inliers >= rules.min_visible)
        kept = standing[good[standing]]
        kept = kept[np.argsort(-scores[kept], kind="stable")]
        estimates = [
            PoseEstimate(
                T_camera_part=Ts[i].copy(),
                score=float(scores[i]),
                visible_share=float(evidence.inliers[i]),
                residual=float(evidence.residual[i] * self.shape.unit),
                n_votes=int(evidence.votes[i]),
            )
            for i in kept
        ]
        return RefineResult(estimates, [], {}, Examined(Ts, looked.features, scores, standing))
