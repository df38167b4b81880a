"""The region of workpieces in a depth image without a calibrated bin: all but large flat surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.ps6d.cloud import FLOOR_MARGIN, ray_slopes

CARRYING, FLAT = 4, 8
"""Most planes looked at: those that carry the scene, as a table and the floor of a bin, then walls and rims."""
TRIALS = 600
POINTS = 3000
BEHIND = 0.02
"""Most of the points that may lie behind a plane that carries the scene: stray pixels."""
FACES = 2.0
"""How many times the workpiece's largest face a flat patch must measure to be more than two of them side by side."""
LENGTHS = 2.5
"""How many times the workpiece's length a flat strip must measure to be a rim."""


@dataclass(frozen=True)
class Plane:
    """Heights over it are normal . p + offset in [m], positive on the camera's side; normal (3,) in camera axes."""

    normal: Array
    offset: float


class _Points:
    """The measured points (h, w, 3) of a frame in camera coordinates [m], and the area (h, w) [m2] a pixel covers."""

    def __init__(self, frame: DepthFrame) -> None:
        right, down = ray_slopes(frame.intrinsics)
        z = frame.depth.astype(np.float64)
        self.xyz = np.stack([right * z, down * z, z], axis=-1)
        self.area = z**2 / (frame.intrinsics.fx * frame.intrinsics.fy)

    def heights(self, plane: Plane) -> Array:
        return np.asarray(self.xyz @ plane.normal + plane.offset)

    def patches(self, on: np.ndarray, plane: Plane) -> list[tuple[np.ndarray, float, float]]:
        """Connected patches of the pixels `on` (h, w): the mask of each, its area [m2] and its length [m]."""
        closed = cv2.morphologyEx(on.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))  # single pixels
        _, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=4)
        largest = 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA])[:8]
        found = []
        for i in largest:
            mask = on & (labels == i)
            points = self.xyz[mask]
            if len(points) < 3:
                break
            slant = np.abs(points @ plane.normal) / np.linalg.norm(points, axis=1)
            axis = np.linalg.svd(np.cov(points.T))[0][:, 0]
            # a pixel covers z^2 / (fx fy) square to its ray
            area = float((self.area[mask] / np.maximum(slant, 0.05)).sum())
            found.append((mask, area, float(np.ptp(points @ axis))))
        return found


def region_of_interest(frame: DepthFrame, workpiece: Workpiece) -> np.ndarray:
    """(h, w) bool: measured pixels that may show workpieces.

    First planes that carry the scene are taken away with all that lies behind them: next to nothing was measured
    there, and a connected patch of the plane is larger than the workpiece's faces. A heap that hides its floor thus
    stays whole. Then go single patches, walls and rims, that are too large or too long for the workpiece.
    """
    points = _Points(frame)
    free = frame.depth > 0
    margin = max(FLOOR_MARGIN, 4 * frame.sigma)
    face, length = FACES * largest_face(workpiece, margin), LENGTHS * float(workpiece.extents.max())
    rng = np.random.default_rng(0)  # the same image gives the same region
    for _ in range(CARRYING):
        plane = find_plane(points.xyz[free], margin, rng, BEHIND)
        if plane is None:
            break
        heights = points.heights(plane)
        patches = points.patches(free & (np.abs(heights) < margin), plane)
        if not any(area > face for _, area, _ in patches):
            break
        free &= heights > margin
    left = free.copy()
    for _ in range(FLAT):
        plane = find_plane(points.xyz[left], margin / 2, rng, 1.0)
        if plane is None:
            break
        on = free & (np.abs(points.heights(plane)) < margin / 2)
        for mask, area, long in points.patches(on, plane):
            if area > 1.5 * face or long > length:
                free &= ~mask
        left &= ~on
    return free


def largest_face(workpiece: Workpiece, margin: float) -> float:
    """Area [m2] of the largest part of the surface that is within `margin` [m] of one plane and turned as it is."""
    points, normals = workpiece.sample_surface(3000)
    of = slice(None, None, 10)  # tangent planes that are tried
    heights = points @ normals[of].T - (points[of] * normals[of]).sum(1)
    flat = (np.abs(heights) < margin) & (normals @ normals[of].T > 0.7)
    return float(flat.mean(0).max() * workpiece.mesh.area)


def find_plane(points: Array, margin: float, rng: np.random.Generator, behind: float) -> Plane | None:
    """By RANSAC the plane with the most points (n, 3) within `margin` [m].

    Args:
        behind: most of the points, as a share, that may lie behind it.
    """
    if len(points) < 64:
        return None
    few = points[rng.choice(len(points), min(POINTS, len(points)), replace=False)]
    a, b, c = (few[rng.integers(len(few), size=TRIALS)] for _ in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    sound = length > 1e-12
    normals, a = normals[sound] / length[sound, None], a[sound]
    offsets = -np.einsum("ij,ij->i", normals, a)
    side = np.where(offsets < 0, -1.0, 1.0)  # the camera, at the origin, has the height `offset`
    normals, offsets = normals * side[:, None], offsets * side
    heights = normals @ few.T + offsets[:, None]
    on = (np.abs(heights) < margin).sum(1)
    on[(heights < -margin).mean(1) > behind] = 0
    if not len(on) or on.max() < 3:
        return None
    best = Plane(normals[on.argmax()], float(offsets[on.argmax()]))
    for _ in range(3):  # least squares over all of its points
        near = points[np.abs(points @ best.normal + best.offset) < margin]
        if len(near) < 3:
            break
        centre = near.mean(0)
        normal = np.linalg.svd(np.cov((near - centre).T))[0][:, 2]
        normal = normal if normal @ centre < 0 else -normal
        best = Plane(normal, float(-normal @ centre))
    return best
