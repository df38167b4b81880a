"""How well a shape matches itself after a rotation: distances of the rotated surface, without mesh noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from pickproof.cell.frames import Array, about_axis, apply, make_transform
from pickproof.cell.geometry.nearest import Nearest

POINTS, COARSE, SCANNED, CORNERS = 3000, 300, 100, 1500
PATCH = 10
"""Number of points in a patch; their mean removes mesh noise and keeps features of the shape."""
NOISE = 5.0
"""Deviation of a single point, in standard deviations of its patch, up to which it counts as noise."""
STEPS, STILL = 8, 1e-5
"""Largest number of registration steps, and the step, as a share of the radius, below which it has converged."""
TRIMMED = 0.8
"""Share of the points, nearest first, used in registration: features that break a symmetry must not move its axis."""


@dataclass(frozen=True)
class Match:
    """How a shape matches itself: largest distance [m], and the share of its surface beyond the tolerance."""

    residual: float
    share: float


class SelfMatch:
    """A closed mesh in [m] that is compared with itself after rotations about the point `centre`.

    Corners are sampled besides points spread over the surface, because a small feature may have no other points.
    """

    def __init__(self, mesh: trimesh.Trimesh, centre: Array, tolerance: float) -> None:
        self.tolerance, self.centre = tolerance, centre
        self._nearest = Nearest(mesh.vertices - centre, mesh.faces)
        spread, _ = trimesh.sample.sample_surface(mesh, POINTS, seed=1)
        self._spread = np.asarray(spread) - centre
        corners = np.asarray(mesh.vertices) - centre
        if len(corners) > CORNERS:
            corners = corners[np.random.default_rng(1).choice(len(corners), CORNERS, replace=False)]
        self._points = np.concatenate([self._spread, corners])
        self.radius = float(np.linalg.norm(mesh.vertices - centre, axis=1).max())

    @cached_property
    def _patches(self) -> np.ndarray:
        """(n, PATCH) points around each."""
        _, around = cKDTree(self._points).query(self._points, k=min(PATCH, len(self._points)))
        return np.asarray(around)

    def coarse(self, T: Array) -> float:
        """Mean distance [m] of a few points moved by T (4, 4)."""
        return float(self._nearest.distances(apply(T, self._spread[:SCANNED])).mean())

    def coarse_worst(self, T: Array) -> float:
        """Distance [m] that 98 % of a few points do not exceed."""
        return float(np.sort(self._nearest.distances(apply(T, self._spread[:COARSE])))[-COARSE // 50])

    def measure(self, T: Array) -> Match:
        """All points moved by T (4, 4)."""
        offset, normal = self._nearest.offsets(apply(T, self._points))
        distance = np.linalg.norm(offset, axis=1)
        signed = np.where(np.einsum("ij,ij->i", offset, normal) < 0, -distance, distance)
        patches = signed[self._patches]
        noise = float(np.median(patches.std(axis=1)))
        mean = np.abs(patches.mean(axis=1))
        left = np.maximum(mean, distance - NOISE * noise)
        return Match(float(left.max()), float((left[: len(self._spread)] > self.tolerance).mean()))

    def settle(self, T: Array) -> Array:
        """T (4, 4) after a few steps of point-to-plane registration of the shape to itself."""
        points = self._spread[:COARSE]
        for _ in range(STEPS):
            moved = apply(T, points)
            offset, normal = self._nearest.offsets(moved)
            along = np.einsum("ij,ij->i", offset, normal)
            kept = np.abs(along) <= np.quantile(np.abs(along), TRIMMED)
            lever = np.cross(moved[kept], normal[kept]) / self.radius
            # directions along which the shape slides on itself are not changed
            step = np.linalg.lstsq(np.concatenate([lever, normal[kept]], axis=1), -along[kept], rcond=0.05)[0]
            step[:3] /= self.radius
            angle = float(np.linalg.norm(step[:3]))
            turn = about_axis(step[:3] / angle, np.array(angle)) if angle > 1e-12 else np.eye(4)
            T = make_transform(t=step[3:]) @ turn @ T
            if max(angle, float(np.abs(step[3:]).max()) / self.radius) < STILL:
                break
        return T
