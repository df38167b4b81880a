"""Pictures of predicted against true poses on the measured depth image."""

from __future__ import annotations

from colorsys import hsv_to_rgb
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from pickproof.cell.frames import Array, apply, invert
from pickproof.cell.sensing.camera import DepthFrame, Intrinsics
from pickproof.cell.workpiece.workpiece import Workpiece

Colour = tuple[int, int, int]
TRUE, IGNORED, WRONG, MISSED = (245, 245, 245), (125, 125, 125), (40, 40, 255), (255, 60, 230)  # BGR
EXACT, LIMIT = 0.58, 0.15
"""Hues of right predictions with errors of SMALL T_e or less (blue) and of T_e (yellow); between by the logarithm."""
SMALL = 0.02
SHARP = 0.5  # [rad] angle between two faces from which their edge is drawn
LEGEND = 26
"""[pixel] height of the legend."""


@dataclass(frozen=True)
class Pictured:
    """What is drawn of a frame.

    Attributes:
        frame: the measured depth.
        Ts_true: (n, 4, 4) true poses in the camera frame in [m].
        counted: (n,) bool, instances that are visible enough to count.
        Ts_pred: (p, 4, 4) predicted poses.
        matched: (p,) instance that each is right about, -1 for none.
        errors: (p,) D to the nearest instance in [m].
    """

    frame: DepthFrame
    Ts_true: Array
    counted: np.ndarray
    Ts_pred: Array
    matched: np.ndarray
    errors: Array

    @property
    def missed(self) -> np.ndarray:
        """(n,) bool, instances that count and were not found."""
        return self.counted & ~np.isin(np.arange(len(self.counted)), self.matched)


def draw_frames(frames: list[Pictured], workpiece: Workpiece, path: Path, columns: int = 2) -> None:
    """A sheet of frames over the legend of `draw_frame`."""
    tiles = [draw_frame(frame, workpiece) for frame in frames]
    if not tiles:
        return
    height, width = np.max([tile.shape[:2] for tile in tiles], axis=0)
    blank = np.full((height, width, 3), 255, np.uint8)
    for i, tile in enumerate(tiles):  # images of a dataset may differ in size
        tiles[i] = blank.copy()
        tiles[i][: tile.shape[0], : tile.shape[1]] = tile
    while len(tiles) % columns:
        tiles.append(blank)
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    sheet = np.vstack([*rows, draw_legend(rows[0].shape[1], workpiece.tolerance)])
    path.write_bytes(png(sheet))


def png(image: np.ndarray) -> bytes:
    """An image (h, w, 3) BGR as PNG."""
    return bytes(cv2.imencode(".png", image)[1])


def draw_frame(pictured: Pictured, workpiece: Workpiece) -> np.ndarray:
    """One tile, (h, w, 3) uint8 BGR.

    True poses are white, grey where too hidden to count, and ringed in magenta where they count and were missed.
    Predicted poses lie over them: from blue to yellow with their error, and red where wrong.
    """
    frame = pictured.frame
    image = grey_depth(frame.depth)
    for T, counts in zip(pictured.Ts_true, pictured.counted, strict=True):
        draw_outline(image, frame.intrinsics, workpiece, T, TRUE if counts else IGNORED, 1)
    for T, match, error in zip(pictured.Ts_pred, pictured.matched, pictured.errors, strict=True):
        colour = error_colour(error / workpiece.tolerance) if match >= 0 else WRONG
        draw_outline(image, frame.intrinsics, workpiece, T, colour, 2)
    for T in pictured.Ts_true[pictured.missed]:
        draw_outline(image, frame.intrinsics, workpiece, T, MISSED, 1)
        u, v = np.rint(frame.intrinsics.project(T[:3, 3])).astype(int)
        cv2.circle(image, (int(u), int(v)), 14, MISSED, 2, cv2.LINE_AA)
    return image


def grey_depth(depth: np.ndarray) -> np.ndarray:
    """A depth image (h, w) as (h, w, 3) uint8 BGR: brighter is nearer, black is missing."""
    seen = depth[depth > 0]
    low, high = np.percentile(seen, [0.5, 99.5]) if len(seen) else (0.0, 1.0)
    near = np.clip((high - depth) / max(high - low, 1e-6), 0, 1)
    return np.asarray(cv2.cvtColor(np.where(depth > 0, 40 + 130 * near, 0).astype(np.uint8), cv2.COLOR_GRAY2BGR))


def error_colour(share: float) -> Colour:
    """Colour BGR of a right prediction whose error is `share` of T_e."""
    s = 1 - np.log(np.clip(share, SMALL, 1.0)) / np.log(SMALL)
    r, g, b = (round(255 * x) for x in hsv_to_rgb((1 - s) * EXACT + s * LIMIT, 0.85, 1.0))
    return b, g, r


def draw_legend(width: int, tolerance: float) -> np.ndarray:
    """(LEGEND, width, 3) uint8 BGR: the colours of `draw_frame` for T_e = `tolerance` in [m]."""
    image = np.full((LEGEND, width, 3), 30, np.uint8)
    x = 8
    for name, colour in (("true", TRUE), ("too hidden to count", IGNORED), ("missed", MISSED), ("wrong", WRONG)):
        x = _entry(image, x, name, [colour] * 14)
    shades = [error_colour(SMALL ** (1 - i / 99)) for i in range(100)]
    _entry(image, x, f"right: error {1e3 * SMALL * tolerance:.2g} to {1e3 * tolerance:.2g} mm", shades)
    return image


def _entry(image: np.ndarray, x: int, text: str, colours: list[Colour]) -> int:
    image[7:-7, x : x + len(colours)] = colours
    x += len(colours) + 6
    cv2.putText(image, text, (x, LEGEND - 9), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (235, 235, 235), 1, cv2.LINE_AA)
    return x + cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.42, 1)[0][0] + 16


def draw_outline(
    image: np.ndarray, K: Intrinsics, workpiece: Workpiece, T_camera_part: Array, colour: Colour, width: int
) -> None:
    """The outline of a workpiece, and its sharp edges that face the camera."""
    mesh = workpiece.mesh
    eye_part = invert(T_camera_part)[:3, 3]
    front = np.einsum("fi,fi->f", mesh.triangles_center - eye_part, mesh.face_normals) < 0
    one, other = front[mesh.face_adjacency].T
    drawn = (one != other) | ((one | other) & (mesh.face_adjacency_angles > SHARP))
    ends = K.project(apply(T_camera_part, workpiece.vertices[mesh.face_adjacency_edges[drawn]]))
    cv2.polylines(image, list(np.rint(ends).astype(np.int32)), False, colour, width, cv2.LINE_AA)
