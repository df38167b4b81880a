"""A picture of poses over the depth image in which they were found."""

from __future__ import annotations

from colorsys import hsv_to_rgb
from pathlib import Path

import cv2
import numpy as np

from pickproof.cell.frames import apply
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.data.overlay import draw_outline, grey_depth, png
from pickproof.perception.pose_estimate import PoseEstimate

WIDTH = 1200
"""[pixel] least width of the picture."""
AXES = ((60, 60, 255), (70, 220, 70), (255, 130, 60))  # BGR of x, y and z
GOLDEN = 0.618033988749895  # hues this far apart stay distinct however many there are


def draw_poses(
    frame: DepthFrame, region: np.ndarray, workpiece: Workpiece, estimates: list[PoseEstimate], path: Path
) -> None:
    """Write outlines, axes and scores of the estimates; what lies outside the region (h, w) is darker."""
    v, u = np.nonzero(region)
    low, high = np.percentile([u, v], [0.5, 99.5], axis=1).astype(int)  # a region has stray pixels
    edge = (0.08 * (high - low)).astype(int) + 8
    low, high = np.maximum(low - edge, 0), np.minimum(high + edge + 1, (region.shape[1], region.shape[0]))
    grow = max(1, int(np.ceil(WIDTH / (high[0] - low[0]))))
    grey = np.where(region[..., None], grey_depth(frame.depth), grey_depth(frame.depth) // 2)
    image = cv2.resize(
        grey[low[1] : high[1], low[0] : high[0]], None, fx=grow, fy=grow, interpolation=cv2.INTER_NEAREST
    )
    K = frame.intrinsics.cropped(low, high, grow)
    for i, estimate in enumerate(estimates):
        r, g, b = (round(255 * x) for x in hsv_to_rgb((0.12 + i * GOLDEN) % 1.0, 0.7, 1.0))
        draw_outline(image, K, workpiece, estimate.T_camera_part, (b, g, r), 2)
    length = 0.35 * float(workpiece.extents.max())
    for i, estimate in enumerate(estimates):
        ends = np.vstack([np.zeros(3), length * np.eye(3)])
        origin, *tips = np.rint(K.project(apply(estimate.T_camera_part, ends))).astype(int).tolist()
        for tip, colour in zip(tips, AXES, strict=True):
            cv2.line(image, origin, tip, colour, 2, cv2.LINE_AA)
        for colour, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):
            text, place = f"{i} {estimate.score:.2f}", (origin[0] + 6, origin[1] - 6)
            cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, colour, width, cv2.LINE_AA)
    path.write_bytes(png(image))
