"""Where in a depth image workpieces may lie, when no calibrated bin says so: on and over the planes that carry them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from cell.camera import DepthFrame
from cell.frames import Array
from cell.workpiece import Workpiece
from perception.cloud import FLOOR_MARGIN, ray_slopes

ROUNDS = 4
"""Most planes taken away: a table, the floor of a bin on it, and what else is flat and has nothing behind it."""
TRIALS = 600
POINTS = 3000
BEHIND = 0.02
"""Most of the points that may lie behind a plane that carries the scene: stray pixels."""
FACES = 2.0
"""How many times the workpiece's largest face a flat patch must measure to be more than two of them side by side."""


@dataclass(frozen=True)
class Plane:
    """Heights over it are normal . p + offset in [m], positive on the camera's side; normal (3,) in camera axes."""

    normal: Array
    offset: float


def region_of_interest(frame: DepthFrame, workpiece: Workpiece) -> np.ndarray:
    """(h, w) bool: measured pixels over the planes that carry the scene.

    A plane carries the scene if next to nothing was measured behind it and one connected patch of it is larger than
    any face of the workpiece. A heap that hides its floor thus stays whole, and so do walls with something behind them.
    """
    right, down = ray_slopes(frame.intrinsics)
    z = frame.depth.astype(np.float64)
    free = frame.depth > 0
    margin = max(FLOOR_MARGIN, 4 * frame.sigma)
    least = FACES * largest_face(workpiece, margin)
    rng = np.random.default_rng(0)  # the same image gives the same region
    for _ in range(ROUNDS):
        v, u = np.nonzero(free)
        if len(v) < 64:
            break
        rays = np.stack([right[0, u], down[v, 0], np.ones(len(v))], axis=1)
        plane = carrying_plane(rays * z[v, u, None], margin, rng)
        if plane is None:
            break
        a, b, c = plane.normal
        height = z * (a * right + b * down + c) + plane.offset
        on = free & (np.abs(height) < margin)
        if _largest_patch(on, frame, plane) < least:
            break
        free &= height > margin
    return free


def largest_face(workpiece: Workpiece, margin: float) -> float:
    """Area [m2] of the largest part of the surface that is within `margin` [m] of one plane and turned as it is."""
    points, normals = workpiece.sample_surface(3000)
    of = slice(None, None, 10)  # tangent planes that are tried
    heights = points @ normals[of].T - (points[of] * normals[of]).sum(1)
    flat = (np.abs(heights) < margin) & (normals @ normals[of].T > 0.7)
    return float(flat.mean(0).max() * workpiece.mesh.area)


def carrying_plane(points: Array, margin: float, rng: np.random.Generator) -> Plane | None:
    """By RANSAC the plane with the most points (n, 3) within `margin` [m], of those with next to none behind them."""
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
    on[(heights < -margin).mean(1) > BEHIND] = 0
    if not len(on) or on.max() < 3:
        return None
    best = Plane(normals[on.argmax()], float(offsets[on.argmax()]))
    for _ in range(3):  # least squares over all of its points
        near = points[np.abs(points @ best.normal + best.offset) < margin]
        centre = near.mean(0)
        normal = np.linalg.svd(np.cov((near - centre).T))[0][:, 2]
        normal = normal if normal @ centre < 0 else -normal
        best = Plane(normal, float(-normal @ centre))
    return best


def _largest_patch(on: np.ndarray, frame: DepthFrame, plane: Plane) -> float:
    """Area [m2] of the largest connected patch of the pixels (h, w)."""
    closed = cv2.morphologyEx(on.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))  # holes of single pixels
    _, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=4)
    if len(stats) < 2:
        return 0.0
    patch = on & (labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax()))
    v, u = np.nonzero(patch)
    right, down = ray_slopes(frame.intrinsics)
    z = frame.depth[v, u].astype(np.float64)
    rays = np.stack([right[0, u], down[v, 0], np.ones(len(v))], axis=1)
    slant = np.maximum(np.abs(rays @ plane.normal), 0.05)  # a pixel covers z^2 / (fx fy) square to the camera's axis
    return float((z**2 / slant).sum() / (frame.intrinsics.fx * frame.intrinsics.fy))
