"""Collision pieces for a mesh: one box or a stack of cylinders where that fits, else convex prisms or hulls.

Fitting is measured: by how far the part sticks out of its pieces, and they out of it where anything touches them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from pickproof.cell.frames import Array, apply
from pickproof.cell.geometry.nearest import Nearest
from pickproof.cell.workpiece.collision_pieces import HULL_MARGIN, CollisionBox, CollisionCylinder, CollisionHull, Piece
from pickproof.cell.workpiece.convex_cuts import convex_cuts
from pickproof.cell.workpiece.piece_errors import error_bound, piece_errors, piece_mesh, widened
from pickproof.cell.workpiece.prism_pieces import prism_pieces

FULL = 0.97
"""Share of its volume that the solid must fill for a single piece to replace it."""
STEP = (0.0005, 0.03)
"""Allowed change of the radius along one cylinder: [m], and share of the largest radius; the larger counts."""
SLICES, MAX_CYLINDERS = 120, 14
HULL = 0.75
"""Share of its hull that a solid fills where one hull is tried."""
CUTS = ((0.9, 32), (0.7, 48))
"""Share of the bound for each hull, and the most hulls; corners of cut bores may lie between samples."""
MAX_CORNERS = 120
MAX_PRISMS = 28
BOXY = 1.05
"""Times its volume that the box around a thin hull may have to stand for it."""
THINNEST = 2.5 * HULL_MARGIN
"""[m] that a hull must be thick for the physics to keep its margin inside of it."""
PLATE = 1.02 * HULL_MARGIN
"""[m] that a hull must be thick to have a middle layer, around which the physics keeps its margin."""
BESIDE = 0.7
"""Of the bound, by which what is left out may stand out of the other pieces."""
SMOOTH = 5e-5
"""[m] that a corner may stand out of a hull without it."""


@dataclass(frozen=True)
class Pieces:
    """Collision pieces, and their deviation from the solid.

    Attributes:
        outside: [m] that the solid sticks out of them at most.
        beyond: [m] that they stick out of the solid at most, as where they close a bore.
        how: in words.
        felt: [m] that they stick out of it where a ball of PROBE comes.
        bound: [m] aimed at for `outside` and `felt`.
    """

    pieces: tuple[Piece, ...]
    outside: float
    beyond: float
    how: str
    felt: float = 0.0
    bound: float = 0.0

    @property
    def within(self) -> bool:
        """Nothing that touches the part finds its pieces off by more than the bound."""
        return max(self.outside, self.felt) <= self.bound


def decompose(mesh: trimesh.Trimesh, turned: bool) -> Pieces:
    """Pieces of a closed mesh in [m] whose bounding box is centred, or whose axis is z where it is `turned`.

    The first of some ways, the cheapest first, that is within the bound; else the one that is off the least.
    """
    bound = error_bound(float(np.max(mesh.extents)))
    found: list[Pieces] = []
    for pieces, how in _ways(mesh, turned, bound):
        outside, beyond, felt = piece_errors(mesh, pieces)
        found.append(Pieces(tuple(pieces), outside, beyond, how, felt, bound))
        if found[-1].within:
            return found[-1]
    return min(found, key=lambda p: max(p.outside, p.felt))


def _ways(mesh: trimesh.Trimesh, turned: bool, bound: float) -> Iterator[tuple[list[Piece], str]]:
    """Pieces, and what they are in words."""
    if box := _box(mesh):
        yield box, "one box"
    if turned and (cylinders := _cylinders(mesh)):
        yield cylinders, f"{len(cylinders)} cylinders about its axis"
    whole = trimesh.convex.convex_hull(mesh)
    if mesh.volume > HULL * whole.volume:
        yield _worded([np.asarray(whole.vertices)], "convex hull", bound)
    if straight := prism_pieces(mesh, MAX_PRISMS):
        yield _worded(straight, "prisms", bound)
    for share, most in CUTS:
        yield _worded(convex_cuts(mesh, share * bound, most), "convex hulls", bound)


def _worded(parts: list[Array], kind: str, bound: float) -> tuple[list[Piece], str]:
    pieces, thick = _hulls(parts, bound)
    boxes = sum(isinstance(piece, CollisionBox) for piece in pieces)
    kinds = ((len(pieces) - boxes, kind), (boxes, "boxes for thin ones"))
    how = " and ".join(f"{n} {what}" for n, what in kinds if n)
    return pieces, how + (f"; {thick} were thickened to {2000 * HULL_MARGIN:g} mm" if thick else "")


def _box(mesh: trimesh.Trimesh) -> list[Piece]:
    low, high = mesh.bounds
    if mesh.volume < FULL * float(np.prod(high - low)):
        return []
    return [CollisionBox(size=tuple((high - low).tolist()), centre=tuple(((low + high) / 2).tolist()))]


def _cylinders(mesh: trimesh.Trimesh) -> list[Piece]:
    """A stack of cylinders along z; empty where the solid is hollow or needs too many."""
    points = trimesh.sample.sample_surface(mesh, 40_000, seed=4)[0]
    low, high = mesh.bounds[:, 2]
    edges = np.linspace(low, high, SLICES + 1)
    which = np.clip(np.searchsorted(edges, points[:, 2]) - 1, 0, SLICES - 1)
    radius = np.zeros(SLICES)
    np.maximum.at(radius, which, np.hypot(points[:, 0], points[:, 1]))
    step = max(STEP[0], STEP[1] * float(radius.max()))
    pieces: list[Piece] = []
    start = 0
    for end in range(1, SLICES + 1):
        of = radius[start : end + 1]
        if end == SLICES or of.max() - of.min() > step:
            mean = float((radius[start:end].max() + radius[start:end].min()) / 2)
            length = float(edges[end] - edges[start])
            centre = (0.0, 0.0, float(edges[end] + edges[start]) / 2)
            pieces.append(CollisionCylinder(radius=mean, length=length, centre=centre))
            start = end
    filled = sum(np.pi * p.radius**2 * p.length for p in pieces if isinstance(p, CollisionCylinder))
    return pieces if len(pieces) <= MAX_CYLINDERS and mesh.volume > (FULL - 0.05) * filled else []


def _hulls(parts: list[Array], bound: float) -> tuple[list[Piece], int]:
    """Hulls, thin ones as boxes where these fit, and how many had to be thickened; no slivers beside others."""
    pieces: list[Piece] = []
    slivers: list[Array] = []
    for vertices in parts:
        corners = _few(vertices)
        box = _around(corners)
        if _thickness(corners) > THINNEST and _sound(corners):
            pieces.append(CollisionHull(corners))
        elif float(np.prod(box.size)) < BOXY * ConvexHull(corners, qhull_options="QJ").volume:
            pieces.append(box)  # the physics keeps its margin within a box, however thin
        elif _sound(corners):
            pieces.append(CollisionHull(corners))
        elif _stands_off(box, corners) < HULL_MARGIN - _thickness(corners) / 2:
            pieces.append(box)
        else:
            slivers.append(corners)
    near = [Nearest(m.vertices, m.faces) for m in map(piece_mesh, pieces)]
    wide = [c for c in slivers if not near or np.min([n.signed(c) for n in near], axis=0).max() > BESIDE * bound]
    for corners in wide:
        thick = _few(widened(corners, PLATE))
        pieces.append(CollisionHull(thick) if _sound(thick) else _around(corners))
    return pieces, len(wide)


def _stands_off(box: CollisionBox, corners: Array) -> float:
    """How far [m] the corners of a box stand out of the hull of points (n, 3)."""
    ends = np.stack(np.meshgrid(*[(-0.5, 0.5)] * 3, indexing="ij"), -1).reshape(-1, 3) * box.size
    planes = ConvexHull(corners, qhull_options="QJ").equations
    return float((apply(box.T_part_box, ends) @ planes[:, :3].T + planes[:, 3]).max())


def _thickness(corners: Array) -> float:
    normals = ConvexHull(corners, qhull_options="QJ").equations[:, :3]
    return float(np.ptp(corners @ normals.T, axis=0).min())


def _sound(corners: Array) -> bool:
    try:
        CollisionHull(np.array(corners)).without_margin()
    except (ValueError, QhullError):
        return False
    return True


def _around(corners: Array) -> CollisionBox:
    """The smallest box around points (n, 3)."""
    to_box, size = trimesh.bounds.oriented_bounds(corners)
    T = np.linalg.inv(to_box)
    R, flat = T[:3, :3], float(np.hypot(T[0, 0], T[1, 0]))
    roll, yaw = (np.arctan2(R[2, 1], R[2, 2]), np.arctan2(R[1, 0], R[0, 0]))
    if flat < 1e-9:  # x points up or down: roll and yaw turn about the same axis
        roll, yaw = np.arctan2(-R[1, 2], R[1, 1]), 0.0
    x, y, z = np.maximum(size, 1e-4).tolist()
    rpy = (float(roll), float(np.arctan2(-R[2, 0], flat)), float(yaw))
    return CollisionBox(size=(x, y, z), centre=tuple(T[:3, 3].tolist()), rpy=rpy)


def _few(vertices: Array) -> Array:
    """The corners of a hull; of more than MAX_CORNERS those that keep nearly all of it.

    Starts with the outermost along the axes; each next corner is the one farthest outside the hull of those before.
    """
    corners = vertices[ConvexHull(vertices, qhull_options="QJ").vertices]
    if len(corners) <= MAX_CORNERS:
        return np.array(corners)
    ends = np.unique([f(corners @ d) for d in np.vstack([np.eye(3), np.ones((1, 3))]) for f in (np.argmin, np.argmax)])
    hull = ConvexHull(corners[ends], incremental=True, qhull_options="QJ")
    for _ in range(MAX_CORNERS - len(ends)):
        outside = (corners @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
        farthest = int(np.argmax(outside))
        if outside[farthest] < SMOOTH:
            break
        hull.add_points(corners[farthest][None])
    return np.array(hull.points[hull.vertices])
