"""Any CAD part in a depth image, without training: search, coarse ICP, coverage, fine ICP, examination, two decisions.

Each step leaves fewer poses and looks at them longer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from pickproof.cell.frames import Array, make_transform
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.pose_estimate import PoseEstimate
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import nearest_rotations
from pickproof.perception.refinement.depth_agreement import soft_score
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.evidence import vote_support
from pickproof.perception.refinement.icp import COARSE, FINE, LAST, register
from pickproof.perception.refinement.refine import Examined, RefineResult
from pickproof.perception.refinement.verify import Evidence, examine, inlier_tolerance, rivalry, suppress
from pickproof.perception.search.cad_table import CadTable, frames_of
from pickproof.perception.search.config import SearchConfig
from pickproof.perception.search.coverage import kept_by_points, poses_at
from pickproof.perception.search.decision import FITTED, Decisions, features_of
from pickproof.perception.search.kernel import best_poses
from pickproof.perception.search.near_misses import NearMisses
from pickproof.perception.search.outside import outside
from pickproof.perception.search.poses import Poses, turned_alike
from pickproof.perception.search.seeds import SeedPixels, Seeds
from pickproof.perception.search.stage_clock import StageClock

COARSE_ALONE = tuple(replace(stage, by_votes=False) for stage in COARSE)
"""Before any membership is known."""
SCORE_POINTS = 192
COARSE_TOLERANCE = 0.03
FINE_TOLERANCE, FINE_SIGMAS = 0.012, 3.0
COARSE_APART, FINE_APART, LAST_APART = 0.03, 0.015, 0.01
LEAST_COARSE = 0.1
ROUGH = 3
"""The rough examination looks at one point in so many."""
CLAIM_REACH = 0.7
"""Factor of the reach once poses are fine."""


@dataclass(frozen=True)
class Scene:
    """One frame, seen as the search needs it.

    Attributes:
        frame: as measured; bin: None where none is known.
        surface: the same, normalised.
        points: where it is asked which poses lie there.
    """

    frame: DepthFrame
    bin: Bin | None
    surface: SurfaceMap
    points: Seeds


@dataclass(frozen=True)
class Search:
    """The search for one workpiece; a frame in, verified poses out."""

    workpiece: Workpiece
    shape: ShapeModel
    table: CadTable
    config: SearchConfig
    decisions: Decisions = FITTED

    @staticmethod
    def of(workpiece: Workpiece, config: SearchConfig | None = None) -> Search:
        """Ready to search (some seconds)."""
        config = config or SearchConfig.model_validate({})
        return Search(workpiece, ShapeModel.of(workpiece), CadTable.of(workpiece, config), config)

    @torch.inference_mode()
    def find(self, frame: DepthFrame, region: np.ndarray, bin: Bin | None, rng: np.random.Generator) -> RefineResult:
        """Verified poses in the pixels `region` (h, w) bool; `rng` chooses the seeds."""
        clock = StageClock()
        surface = SurfaceMap.of(frame, self.shape.unit, frame.sigma, region)
        pixels = SeedPixels(surface)
        points = pixels.one_a_voxel(self.config.vote_voxel, rng)
        scene = Scene(frame, bin, surface, points)
        clock.lap("surface")
        found = self._poses_at_seeds(pixels, surface, rng)
        clock.lap("search")
        coarse = self._registered_coarsely(found, scene)
        clock.lap("coarse")
        fine = self._registered_finely(coarse, scene)
        clock.lap("icp")
        result = self._decided(self._looked_at_roughly(fine, scene), scene)
        clock.lap("verify")
        return replace(result, seconds=clock.seconds)

    def _poses_at_seeds(self, pixels: SeedPixels, surface: SurfaceMap, rng: np.random.Generator) -> Poses:
        """The best poses of every seed."""
        config, table, shape = self.config, self.table, self.shape
        per_seed = len(table.samples) * len(table.turns)
        most = max(1, int(config.most_poses / per_seed))
        seeds = pixels.one_a_voxel(config.voxel, rng, config.least_seeds, most)
        n, keep = len(seeds), config.keep
        R, t = np.zeros((n, keep, 3, 3), np.float32), np.zeros((n, keep, 3), np.float32)
        scores = np.full((n, keep), -1.0, np.float32)
        image, camera = _half_image(surface)
        best_poses(
            seeds.points, frames_of(seeds.normals.astype(np.float64)), table.samples, table.frames, table.seen,
            table.view_at, shape.visible.numpy(), shape.visible_normals.numpy(), table.turns, image, camera,
            np.float32(config.least_score), np.float32(config.tolerance), R, t, scores,
        )  # fmt: skip
        good = scores > 0
        alike = turned_alike(R[good].astype(np.float64), shape.symmetry).astype(np.float32)
        return Poses(torch.from_numpy(alike), torch.from_numpy(t[good]), scores[good])

    def _registered_coarsely(self, poses: Poses, scene: Scene) -> Poses:
        shape = self.shape
        poses = poses.distinct(shape, self.config.apart, self.config.most_coarse)
        R, t = register(poses.rotations, poses.positions, scene.surface, shape, COARSE_ALONE)
        scores = soft_score(R, t, scene.surface, shape, SCORE_POINTS, COARSE_TOLERANCE * shape.fineness).numpy()
        poses = Poses(R, t, scores).distinct(shape, COARSE_APART)
        return poses.select(np.flatnonzero(poses.scores > LEAST_COARSE))

    def _registered_finely(self, poses: Poses, scene: Scene) -> Poses:
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
        return Poses(R, t, scores).distinct(shape, FINE_APART)

    def _looked_at_roughly(self, poses: Poses, scene: Scene) -> Poses:
        """Plausible poses in the order of the decision, those that some point keeps."""
        if not len(poses):
            return poses
        evidence, _, log_odds = self._examined(poses, scene, ROUGH)
        plausible = (evidence.ratio >= self.config.least_ratio) & (
            evidence.inliers >= self.config.verify.min_visible
        )
        poses = replace(poses, scores=log_odds)
        i = np.flatnonzero(plausible)
        poses = poses.select(i[np.argsort(-log_odds[i], kind="stable")])
        at = poses_at(scene.points, poses, self.shape, CLAIM_REACH * self.config.reach, self.config.claims_per_point)
        return poses.select(kept_by_points(at))

    def _examined(self, poses: Poses, scene: Scene, every: int = 1) -> tuple[Evidence, Array, Array]:
        """Evidence, features and log odds of the order."""
        R, t, rules = poses.rotations, poses.positions, self.config.verify
        evidence = examine(R, t, scene.surface, self.shape, rules, every=every)
        beyond = outside(R, t, self.shape, scene.frame, scene.bin, 5 if every == 1 else 10)
        tolerance = inlier_tolerance(scene.surface, rules)
        near = NearMisses.of(poses, scene.surface, self.shape, tolerance)
        features = features_of(evidence, beyond, near, tolerance)
        return evidence, features, self.decisions.order.log_odds(features)

    def _decided(self, poses: Poses, scene: Scene) -> RefineResult:
        if not len(poses):
            return RefineResult([], [], {})
        shape, rules = self.shape, self.config.verify
        R, t = register(poses.rotations, poses.positions, scene.surface, shape, LAST)
        poses = Poses(R, t, poses.scores)
        _, _, log_odds = self._examined(poses, scene)
        poses = Poses(R, t, log_odds).distinct(shape, LAST_APART)
        evidence, features, _ = self._examined(poses, scene)
        R, t = poses.rotations, poses.positions
        shared, overlap = rivalry(R, t, scene.surface, shape, rules)
        standing = np.asarray(suppress(np.arange(len(poses)), shared, overlap, rules), dtype=np.int64)
        at = poses_at(scene.points, poses, shape, CLAIM_REACH * self.config.reach, 1)[:, 0]
        have = at >= 0
        R64, t64 = R.numpy().astype(np.float64), t.numpy().astype(np.float64)
        votes = Votes(scene.points.points[have].astype(np.float64), t64[at[have]], R64[at[have]])
        tolerance = inlier_tolerance(scene.surface, rules)
        support = vote_support(R[standing], t[standing], shape, 2 * tolerance, votes)
        x = features.copy()
        x[standing, 8], x[standing, 9], x[standing, 10] = np.log1p(2 * support[0]), support[1], support[2]
        scores = self.decisions.acceptance.score(x)
        Ts = make_transform(nearest_rotations(R64), t64 * shape.unit)
        good = standing[
            (scores[standing] >= self.decisions.threshold)
            & (evidence.ratio[standing] >= rules.min_ratio)
            & (evidence.inliers[standing] >= rules.min_visible)
        ]
        good = good[np.argsort(-scores[good], kind="stable")]
        estimates = [
            PoseEstimate(Ts[i].copy(), float(scores[i]), float(evidence.inliers[i]),
                float(evidence.residual[i] * shape.unit), int(np.expm1(x[i, 8]) / 2))
            for i in good
        ]
        return RefineResult(estimates, [], {}, Examined(Ts, x, scores, standing))


def _half_image(surface: SurfaceMap) -> tuple[np.ndarray, np.ndarray]:
    """Every second pixel (h, w, 5): depth, normal, nearest depth; and fx, fy, cx, cy of that image."""
    K = surface.intrinsics
    table = surface.table.numpy().reshape(K.height, K.width, 8)[::2, ::2]
    camera = np.array([K.fx / 2, K.fy / 2, K.cx / 2, K.cy / 2], np.float32)
    return np.ascontiguousarray(table[..., 2:7]), camera
