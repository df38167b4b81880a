"""What perception precomputes of a workpiece once: samples, moments, distance field, visible points, near symmetries.

Everything here is in normalised CAD coordinates: 1 is `workpiece.unit`.
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from torch import Tensor

from pickproof.cell.frames import Array
from pickproof.cell.geometry.raycast import make_caster
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.cad.distance_field import DistanceField
from pickproof.perception.cad.silhouettes import outlines

VIEWS = 192
SURFACE_POINTS, VISIBLE_POINTS = 1500, 384
"""For each unit of the part's length, begun ones counted whole."""
OFF_SURFACE = 1e-3
"""Start of a ray of the self-occlusion test over its surface."""
RIM_SAMPLES = 20_000
MAX_NEAR_SYMMETRIES = 8
THIN = 0.15
"""Thickness from which on lengths are taken as they stand."""
HALO = 0.12
"""Width of the band around the outline from which scene points are drawn while a pose is still coarse."""


@dataclass(frozen=True)
class ShapeModel:
    """Precomputed geometry of one workpiece.

    Attributes:
        unit: [m] of 1.
        density: `Workpiece.units_long`, factor of the numbers of samples.
        points, normals: (n, 3) uniform surface samples.
        moment_root: (3, 3) C with C C^T = E[x x^T] of the v-masked surface: |R1 C - R2 C| is the root mean square
            distance of the surface in two poses of equal position (Bregier et al. 2018, eq. 9).
        field: signed distance.
        symmetry: of the workpiece.
        near_symmetries: (k, 3, 3) rotations, identity first, that map the part nearly to itself.
        views: (w, 3) directions from the part to the camera.
        visible, visible_normals: (w, p, 3) points seen from each view, dense as its pixels are, in random order, so
            that any prefix is a fair sample.
        halo: (w, p, 3) the same, scattered sideways by up to HALO.
        rim, rim_outward: (w, q, 3) points evenly along the outline in each view, holes included, and the direction
            across it, outward and square to the view.
        thickness: diameter of the largest ball inside the part.
        seen_area: (w,) area of the part's outline in each view.
        form_tolerance: standard deviation of a real part's surface from the CAD.
    """

    unit: float
    density: int
    points: Array
    normals: Array
    moment_root: Array
    field: DistanceField
    symmetry: Symmetry
    near_symmetries: Array
    views: Tensor
    visible: Tensor
    visible_normals: Tensor
    halo: Tensor
    rim: Tensor
    rim_outward: Tensor
    thickness: float
    seen_area: Tensor
    form_tolerance: float = 0.0

    @staticmethod
    def of(workpiece: Workpiece) -> ShapeModel:
        """The model of a workpiece; computed once a process (about 3 s)."""
        return _build(_Key(workpiece))

    @functools.cached_property
    def long_axis(self) -> Array:
        """Unit vector (3,) of the longest principal axis."""
        return principal_axes(self.points)[:, 2]

    @functools.cached_property
    def length(self) -> float:
        """Extent along the long axis."""
        return float(np.ptp(self.points @ self.long_axis))

    def deviation(self, sigma: float) -> float:
        """Standard deviation [m] of a measured depth from the CAD, given that of the camera, `sigma` [m]."""
        return math.hypot(sigma, self.form_tolerance * self.unit) if self.form_tolerance > 0 else sigma

    @property
    def slender(self) -> bool:
        """Whether the unit is less than the longest side."""
        return self.density > 1

    @property
    def fineness(self) -> float:
        """Factor of the lengths within which surfaces are sought: below 1 for a slender part, which is thin besides."""
        return min(1.0, self.thickness / THIN) if self.slender else 1.0

    @functools.cached_property
    def elongation(self) -> tuple[np.ndarray, np.float32]:
        """Long axis (3,), and what the square of an offset along it loses: 1 - 1 / length^2 of it, 0 unless slender."""
        less = 1 - 1 / self.length**2 if self.slender else 0.0
        return self.long_axis.astype(np.float32), np.float32(less)

    def fold(self, positions: Array, R: Array, origin: Array) -> Array:
        """Positions (n, 3) with what lies along the long axis of R (n, 3, 3), from `origin`, divided by its length.

        Along a slender part few points see an end, so predicted centres scatter there several times more than across.
        """
        if not self.slender:
            return positions
        axis = R @ self.long_axis
        along = ((positions - origin) * axis).sum(1)
        return positions - ((1 - 1 / self.length) * along)[:, None] * axis

    def embed(self, R: np.ndarray) -> np.ndarray:
        """Rotations (..., 3, 3) as vectors (..., d) whose distance is a root mean square surface distance."""
        return (R @ self.moment_root).reshape(*R.shape[:-2], 3 * self.moment_root.shape[1])

    def view_of(self, R: Tensor, t: Tensor) -> Tensor:
        """Index (h,) of the precomputed view nearest to that of poses (h, 3, 3), (h, 3)."""
        to_camera = -(R.transpose(1, 2) @ t[:, :, None])[..., 0]
        return (to_camera @ self.views.T).argmax(1)


class _Key:
    """A workpiece hashed by what it looks like, so that equal parts share one model."""

    def __init__(self, workpiece: Workpiece) -> None:
        self.workpiece = workpiece
        mesh = workpiece.vertices.tobytes(), workpiece.faces.tobytes()
        self.key = (*mesh, workpiece.symmetry.degrees, workpiece.form_tolerance)

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self.key == other.key


@functools.lru_cache(maxsize=4)
def _build(key: _Key) -> ShapeModel:
    workpiece = key.workpiece
    unit = workpiece.unit
    mesh = trimesh.Trimesh(workpiece.vertices / unit, workpiece.faces, process=False)
    density = workpiece.units_long
    points, normals = workpiece.sample_surface(SURFACE_POINTS * density)
    points = points / unit
    field = DistanceField.of(mesh)
    views = fibonacci_sphere(VIEWS)
    visible, visible_normals, halo, area = _visible_sets(mesh, points, normals, VISIBLE_POINTS * density, views)
    rim, rim_outward = outlines(workpiece.sample_surface(RIM_SAMPLES)[0] / unit, views)
    nodes = field.table[:, 0] + (field.nodes() * field.table[:, 1:]).sum(1)
    return ShapeModel(
        unit=unit,
        density=density,
        points=points,
        normals=normals,
        moment_root=moment_root(points, workpiece.symmetry.v),
        field=field,
        symmetry=workpiece.symmetry,
        near_symmetries=near_symmetries(points, field, workpiece.symmetry),
        views=torch.from_numpy(views.astype(np.float32)),
        visible=visible,
        visible_normals=visible_normals,
        halo=halo,
        rim=rim,
        rim_outward=rim_outward,
        thickness=2.0 * float(-nodes.min()),
        seen_area=area,
        form_tolerance=workpiece.form_tolerance / unit,
    )


def principal_axes(points: Array) -> Array:
    """Columns (3, 3), a right-handed frame, of the second moment of points (n, 3)."""
    axes = np.linalg.eigh(points.T @ points)[1]
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    return axes


def moment_root(points: Array, v: Array) -> Array:
    """C (3, d) with C C^T = E[(x v)(x v)^T]; only the columns that are not zero."""
    masked = points * v
    values, axes = np.linalg.eigh(masked.T @ masked / len(points))
    keep = values > 1e-9
    return axes[:, keep] * np.sqrt(values[keep])


def near_symmetries(points: Array, field: DistanceField, symmetry: Symmetry, tolerance: float = 0.07) -> Array:
    """Rotations of the cube, about the principal and about the CAD axes, that map the part nearly to itself.

    Nearly: the mean distance to the surface stays below `tolerance`. True symmetries are left out: they are no
    different pose.
    """
    scored = []
    for axes in (np.eye(3), principal_axes(points)):
        for permutation, signs in itertools.product(
            itertools.permutations(range(3)), itertools.product((1.0, -1.0), repeat=3)
        ):
            turn = np.eye(3)[list(permutation)] * np.asarray(signs)[:, None]
            if np.linalg.det(turn) > 0:
                R = axes @ turn @ axes.T
                distance, _ = field.look_up(torch.from_numpy((points @ R.T).astype(np.float32)))
                scored.append((float(distance.abs().mean()), R))
    kept = [np.eye(3)]
    masked = points * symmetry.v
    for error, R in sorted(scored, key=lambda pair: pair[0]):
        gaps = [np.sqrt(((masked @ (R - k @ s).T) ** 2).sum(1).mean()) for k in kept for s in symmetry.S]
        if error < tolerance and min(gaps) > 0.06 and len(kept) < MAX_NEAR_SYMMETRIES:
            kept.append(R)
    return np.stack(kept)


def fibonacci_sphere(n: int) -> Array:
    """n nearly even unit vectors."""
    i = np.arange(n) + 0.5
    z = 1 - 2 * i / n
    angle = np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], -1)


def _visible_sets(
    mesh: trimesh.Trimesh, points: Array, normals: Array, count: int, views: Array
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    rng = np.random.default_rng(0)
    caster = make_caster(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    visible, facing, halo, area = [], [], [], []
    for view in views:
        cos = normals @ view
        candidates = np.flatnonzero(cos > 0.02)
        # a ray towards the camera that meets the part again is blocked by it
        hits = caster.cast(points[candidates] + OFF_SURFACE * normals[candidates], np.tile(view, (len(candidates), 1)))
        seen = candidates[~np.isfinite(hits.t)]
        weight = cos[seen]
        pick = seen[rng.choice(len(seen), count, p=weight / weight.sum())]
        side = rng.standard_normal((count, 3))
        side -= (side @ view)[:, None] * view
        side *= (HALO * np.sqrt(rng.random(count)) / np.linalg.norm(side, axis=1))[:, None]
        visible.append(points[pick])
        facing.append(normals[pick])
        halo.append(points[pick] + side)
        area.append(weight.sum() * mesh.area / len(points))
    stack = [torch.from_numpy(np.stack(x).astype(np.float32)) for x in (visible, facing, halo)]
    return stack[0], stack[1], stack[2], torch.tensor(area, dtype=torch.float32)
