"""Point pair features (Drost et al. 2010) as OpenCV implements them: the classical peer of PS6D.

Settings, how they were tuned and what OpenCV leaves open stand in docs/measurements/perception.md.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from pickproof.cell.config import Config
from pickproof.cell.frames import Array, make_transform
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.evaluation.average_precision import pose_distances
from pickproof.perception.pose_estimate import PoseEstimate
from pickproof.perception.ps6d.cloud import roi_mask
from pickproof.perception.refinement.depth_surface import SurfaceMap

Cloud6 = NDArray[np.float32]
"""(n, 6) points in diameters and unit normals, the layout that OpenCV asks for."""

SCALE = 100.0
"""Coordinates that OpenCV gets, in diameters. It averages hypotheses closer than `distance_step` units whatever their
rotation (its bound on the angle is 360 over the step in rad, read as degrees: 30 rad), so none in large coordinates."""

MODEL_SAMPLES = 20_000
BINS = 0.01
"""OpenCV thins a scene to 1 / BINS cells along each side of its bounding box, slender cells in a slender box. Clouds
are thinned to cubic cells before (`_thin`), so its own cells are too small to matter. In training it does the same with
its sampling step, which is also the bin of the distance; its distance step is not used."""
MIN_POINTS = 50
"""Fewest points that are matched or registered; OpenCV fails on degenerate clouds."""


class PpfConfig(Config):
    """Settings; lengths in diameters, that is diagonals of the CAD's bounding box."""

    model_step: float = Field(0.08, gt=0.02, le=0.3, description="cell of the model's points")
    scene_step: float = Field(0.06, gt=0.02, le=0.3, description="cell of the scene's points")
    distance_step: float = Field(0.05, ge=0.01, le=0.1, description="bin of the pair's distance")
    angles: int = Field(30, ge=4, le=180, description="bins of a full turn, of the feature's angles and of the votes")
    reference_share: float = Field(0.5, gt=0, le=1, description="share of the scene's points that vote")
    merge: float = Field(0.12, ge=0, le=1, description="hypotheses closer than this (Bregier) are one; votes add up")
    refined: float = Field(2.0, ge=1, description="hypotheses registered, over the number asked for")
    icp_step: float = Field(0.03, gt=0, le=0.3, description="cell of the points that ICP takes")
    icp_iterations: int = Field(30, ge=0, description="0 for no ICP")
    icp_levels: int = Field(6, ge=1, le=10)
    icp_tolerance: float = Field(0.05, gt=0, description="change of the pose at which a level ends")
    icp_rejection: float = Field(1.0, gt=0, description="distances over this times their spread are rejected")


class Ppf:
    """A trained detector of one workpiece. Training takes below a second; OpenCV's Python binding cannot store it."""

    def __init__(self, workpiece: Workpiece, config: PpfConfig, detector: Any, surface: Cloud6) -> None:
        self.workpiece, self.config = workpiece, config
        self._detector, self._surface = detector, surface

    @staticmethod
    def train(workpiece: Workpiece, config: PpfConfig | None = None) -> Ppf:
        """Hash the point pairs of the CAD's surface."""
        config = config or PpfConfig()
        points, normals = workpiece.sample_surface(MODEL_SAMPLES)
        surface = np.hstack([points / _diameter(workpiece), normals]).astype(np.float32)
        detector = cv2.ppf_match_3d.PPF3DDetector(config.distance_step, config.distance_step, config.angles)
        detector.trainModel(_scaled(_thin(surface, config.model_step)))
        return Ppf(workpiece, config, detector, _thin(surface, config.icp_step))

    def detect(self, frame: DepthFrame, bin: Bin, true_count: int) -> list[PoseEstimate]:
        """At most `true_count` poses, most votes first; PPF is told the number of visible parts, as in the paper.

        A score is the share of the frame's votes, the residual OpenCV's of its ICP; the visible share is unknown (NaN).
        """
        scene = self._scene(frame, bin)
        sample = _thin(scene, self.config.scene_step)
        if true_count < 1 or len(sample) < MIN_POINTS:
            return []
        found = self._detector.match(_scaled(sample), self.config.reference_share, BINS)
        if not found:
            return []
        Ts = np.stack([h.pose for h in found])
        Ts[:, :3, 3] /= SCALE
        Ts, votes = self._cluster(Ts, np.array([h.numVotes for h in found], dtype=np.float64))
        kept = self._distinct(Ts, int(np.ceil(self.config.refined * true_count)))
        scene = _thin(scene, self.config.icp_step)
        registered = [self._register(T, scene) for T in Ts[kept]]
        Ts = np.stack([T for T, _ in registered])
        unit = _diameter(self.workpiece)
        return [
            PoseEstimate(
                T_camera_part=make_transform(Ts[i, :3, :3], Ts[i, :3, 3] * unit),
                score=float(votes[kept[i]] / votes.sum()),
                visible_share=float("nan"),
                residual=registered[i][1] * unit,
                n_votes=int(votes[kept[i]]),
            )
            for i in self._distinct(Ts, true_count)
        ]

    def _scene(self, frame: DepthFrame, bin: Bin) -> Cloud6:
        """Points of interest that have a normal, in diameters."""
        unit = _diameter(self.workpiece)
        table = SurfaceMap.of(frame, unit, 0.0, roi_mask(frame, bin)).table.numpy()
        return table[(table[:, 2] > 0) & table[:, 3:6].any(axis=1), :6]

    def _cluster(self, Ts: Array, votes: Array) -> tuple[Array, Array]:
        """Hypotheses (n, 4, 4) in diameters and their votes (n,), close ones added up, most votes first."""
        in_metres = Ts.copy()
        in_metres[:, :3, 3] *= _diameter(self.workpiece)
        limit = self.config.merge * _diameter(self.workpiece)
        near = pose_distances(in_metres, in_metres, self.workpiece) <= limit
        total = near @ votes
        kept: list[int] = []
        taken = np.zeros(len(Ts), dtype=bool)
        for i in np.argsort(-total, kind="stable"):
            if not taken[i]:
                taken |= near[i]
                kept.append(int(i))
        return Ts[kept], total[kept]

    def _distinct(self, Ts: Array, count: int) -> list[int]:
        """The first `count` of poses (n, 4, 4) whose origins keep half the least side of the box from one another."""
        apart = 0.5 * float(self.workpiece.extents.min()) / _diameter(self.workpiece)
        kept: list[int] = []
        for i, t in enumerate(Ts[:, :3, 3]):
            if len(kept) < count and all(np.linalg.norm(t - Ts[j, :3, 3]) > apart for j in kept):
                kept.append(i)
        return kept

    def _register(self, T: Array, scene: Cloud6) -> tuple[Array, float]:
        """OpenCV's ICP of the surface that faces the camera in a pose (4, 4), and its residual, in diameters."""
        points = self._surface[:, :3] @ T[:3, :3].T + T[:3, 3]
        facing = ((self._surface[:, 3:] @ T[:3, :3].T) * points).sum(axis=1) < 0
        near = scene[np.linalg.norm(scene[:, :3] - T[:3, 3], axis=1) < 0.8]
        c = self.config
        if c.icp_iterations == 0 or min(int(facing.sum()), len(near)) < MIN_POINTS:
            return T, float("nan")
        start = cv2.ppf_match_3d.Pose3D()
        start.updatePose(T)
        icp = cv2.ppf_match_3d.ICP(c.icp_iterations, c.icp_tolerance, c.icp_rejection, c.icp_levels)
        _, (found,) = icp.registerModelToScene(self._surface[facing], near, [start])
        return found.pose, float(found.residual)


def _diameter(workpiece: Workpiece) -> float:
    return float(np.linalg.norm(workpiece.extents))


def _scaled(cloud: Cloud6) -> Cloud6:
    return np.hstack([SCALE * cloud[:, :3], cloud[:, 3:]])


def _thin(cloud: Cloud6, step: float) -> Cloud6:
    """The first point of each cubic cell and direction of normal, so that both sides of a thin wall stay."""
    cells = np.hstack([np.floor(cloud[:, :3] / step), np.rint(1.2 * cloud[:, 3:])]).astype(np.int64)
    return np.ascontiguousarray(cloud[np.sort(np.unique(cells, axis=0, return_index=True)[1])])
