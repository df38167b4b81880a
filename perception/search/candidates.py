"""From millions of poses to some hundred: search, coarse ICP, coverage, fine ICP.

Each step leaves fewer poses and looks at them longer. Steps are functions of a scene and the poses of the step before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.refinement.depth_agreement import soft_score
from pickproof.perception.refinement.icp import COARSE, FINE, register
from pickproof.perception.search.cad_table import CadTable, frames_of
from pickproof.perception.search.config import SearchConfig
from pickproof.perception.search.coverage import kept_by_points, poses_at
from pickproof.perception.search.kernel import best_poses
from pickproof.perception.search.poses import Poses, turned_alike
from pickproof.perception.search.scene import Scene
from pickproof.perception.search.seeds import Seeds
from pickproof.perception.search.slide import slid

COARSE_ALONE = tuple(replace(stage, by_votes=False) for stage in COARSE)
"""Before any membership is known."""
SCORE_POINTS = 192
COARSE_TOLERANCE = 0.03
FINE_TOLERANCE, FINE_SIGMAS = 0.012, 3.0
"""[units] at least, and standard deviations of the depth."""
COARSE_APART, FINE_APART = 0.03, 0.015
"""[units] of poses that are told apart after each registration."""
LEAST_COARSE = 0.1
"""Score below which a registered pose is given up."""


@dataclass(frozen=True)
class Candidates:
    """The steps for one workpiece."""

    shape: ShapeModel
    table: CadTable
    config: SearchConfig

    @property
    def most_seeds(self) -> int:
        """Seeds with which a frame stays within its number of poses."""
        return max(1, int(self.config.most_poses / (len(self.table.samples) * len(self.table.turns))))

    def at_seeds(self, seeds: Seeds, scene: Scene) -> Poses:
        """The best poses of every seed."""
        config, table, shape = self.config, self.table, self.shape
        n, keep = len(seeds), config.keep
        R, t = np.zeros((n, keep, 3, 3), np.float32), np.zeros((n, keep, 3), np.float32)
        scores = np.full((n, keep), -1.0, np.float32)
        best_poses(
            seeds.points, frames_of(seeds.normals.astype(np.float64)), table.samples, table.frames, table.seen,
            table.view_at, shape.visible.numpy(), shape.visible_normals.numpy(), table.turns, *scene.half_image(),
            np.float32(config.least_score), np.float32(config.tolerance), R, t, scores,
        )  # fmt: skip
        good = scores > 0
        alike = turned_alike(R[good].astype(np.float64), shape.symmetry).astype(np.float32)
        return Poses(torch.from_numpy(alike), torch.from_numpy(t[good]), scores[good])

    def registered_coarsely(self, poses: Poses, scene: Scene) -> Poses:
        """Different ones alone, and only those that the depth image does not contradict."""
        poses = poses.distinct(self.shape, self.config.apart, self.config.most_coarse)
        R, t = register(poses.rotations, poses.positions, scene.surface, self.shape, COARSE_ALONE)
        return self.plausible(Poses(R, t, self.coarse_scores(R, t, scene)))

    def coarse_scores(self, R: torch.Tensor, t: torch.Tensor, scene: Scene) -> np.ndarray:
        """By which poses (h, 3, 3), (h, 3) of coarse registration are compared (h,)."""
        tolerance = COARSE_TOLERANCE * self.shape.fineness
        return np.asarray(soft_score(R, t, scene.surface, self.shape, SCORE_POINTS, tolerance).numpy())

    def plausible(self, poses: Poses) -> Poses:
        """Distinct poses with more than the least score."""
        poses = poses.distinct(self.shape, COARSE_APART)
        return poses.select(np.flatnonzero(poses.scores > LEAST_COARSE))

    def registered_finely(self, poses: Poses, scene: Scene) -> Poses:
        """Only the poses that some point keeps; the best one of a point says which part it belongs to."""
        shape, config = self.shape, self.config
        at = poses_at(scene.points, poses, shape, config.reach, config.poses_per_point)
        known = at[:, 0] >= 0
        if not known.any():
            return Poses.none()
        centres = poses.positions.numpy()[at[known, 0]]
        surface = scene.surface.with_centres(scene.points.points[known], centres)
        poses = poses.select(kept_by_points(at))
        R, t = register(poses.rotations, poses.positions, surface, shape, FINE)
        tolerance = max(FINE_TOLERANCE, FINE_SIGMAS * surface.sigma) * shape.fineness
        scores = soft_score(R, t, surface, shape, SCORE_POINTS, tolerance).numpy()
        return slid(Poses(R, t, scores), surface, shape, 2 * SCORE_POINTS, tolerance).distinct(shape, FINE_APART)
