"""Pictures of predicted against true poses on the measured depth image."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from cell.camera import DepthFrame
from cell.frames import Array, apply
from cell.workpiece import Workpiece
from perception.pose_estimate import PoseEstimate

TRUE, IGNORED, RIGHT, WRONG = (90, 200, 90), (130, 130, 130), (255, 160, 30), (40, 40, 255)  # BGR

Pictured = tuple[DepthFrame, Array, np.ndarray, list[PoseEstimate], np.ndarray]
"""Frame, true poses (n, 4, 4), which of them count (n,), estimates, instance each is right about (-1: wrong)."""


def draw_frames(frames: list[Pictured], workpiece: Workpiece, path: Path, columns: int = 2) -> None:
    """A sheet: true poses green (grey where too occluded to count), right estimates blue, wrong ones red."""
    tiles = [draw_frame(*frame, workpiece) for frame in frames]
    if not tiles:
        return
    while len(tiles) % columns:
        tiles.append(np.full_like(tiles[0], 255))
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    cv2.imwrite(str(path), np.vstack(rows))


def draw_frame(
    frame: DepthFrame, truth: Array, counted: np.ndarray, estimates: list[PoseEstimate], matched: np.ndarray,
    workpiece: Workpiece,
) -> np.ndarray:  # fmt: skip
    """One tile, (h, w, 3) uint8 BGR."""
    seen = frame.depth[frame.depth > 0]
    low, high = np.percentile(seen, [0.5, 99.5]) if len(seen) else (0.0, 1.0)
    near = np.clip((high - frame.depth) / max(high - low, 1e-6), 0, 1)
    image = cv2.cvtColor(np.where(frame.depth > 0, 60 + 150 * near, 0).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    edges = workpiece.mesh.face_adjacency_edges[workpiece.mesh.face_adjacency_angles > 0.5]
    for T, counts in zip(truth, counted, strict=True):
        _outline(image, frame, apply(T, workpiece.vertices)[edges], TRUE if counts else IGNORED, 2 if counts else 1)
    for estimate, match in zip(estimates, matched, strict=True):
        points = apply(estimate.T_camera_part, workpiece.vertices)[edges]
        _outline(image, frame, points, RIGHT if match >= 0 else WRONG, 1)
    return image


def _outline(image: np.ndarray, frame: DepthFrame, ends: Array, colour: tuple[int, int, int], width: int) -> None:
    for a, b in np.rint(frame.intrinsics.project(ends)).astype(int):
        cv2.line(image, tuple(map(int, a)), tuple(map(int, b)), colour, width, cv2.LINE_AA)
