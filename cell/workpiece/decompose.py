"""Collision pieces for a mesh: one box or a stack of cylinders where that fits, else convex hulls by CoACD.

CoACD measures concavity relative to the longest side, so a slender part would stay one hull. Each axis is scaled to 1
first (convexity is preserved), and the pieces are scaled back.
Source: Wei et al., "Approximate Convex Decomposition for 3D Meshes with Collision-Aware Concavity and Tree Search"
(2022).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from pickproof.cell.frames import Array
from pickproof.cell.geometry.nearest import Nearest
from pickproof.cell.workpiece.collision_pieces import HULL_MARGIN, CollisionBox, CollisionCylinder, CollisionHull, Piece
from pickproof.cell.workpiece.prism_pieces import prism_pieces

FULL = 0.97
"""Share of its volume that the solid must fill for a single piece to replace it."""
STEP = (0.0005, 0.03)
"""Allowed change of the radius along one cylinder: [m], and share of the largest radius; the larger counts."""
SLICES, MAX_CYLINDERS = 120, 14
THRESHOLD, MAX_HULLS, HULL_VERTICES, MAX_CORNERS = 0.06, 16, 48, 120
MAX_PRISMS = 28
BOXY = 1.35
"""Largest ratio of volumes at which a box replaces a thin hull."""
THINNEST = 3.2 * HULL_MARGIN
"""[m] smallest thickness of a hull that keeps the margin of the physics inside."""
SMOOTH = 5e-5
"""[m] distance of a corner from the hull of the others up to which it may be left out."""
SAMPLES = 3000


@dataclass(frozen=True)
class Pieces:
    """Collision pieces, and their deviation from the solid.

    Attributes:
        outside: [m] largest distance of the solid beyond the pieces.
        beyond: [m] largest distance of the pieces beyond the solid, as where they close a bore.
        how: description in words.
    """

    pieces: tuple[Piece, ...]
    outside: float
    beyond: float
    how: str


def decompose(mesh: trimesh.Trimesh, turned: bool) -> Pieces:
    """Pieces of a closed mesh in [m] whose bounding box is centred, or whose axis is z where it is `turned`."""
    pieces, how = _box(mesh), "one box"
    if not pieces and turned:
        pieces = _cylinders(mesh)
        how = f"{len(pieces)} cylinders about its axis"
    if not pieces:
        parts, kind = _convex_parts(mesh)
        pieces, thick = _hulls(parts)
        boxes = sum(isinstance(piece, CollisionBox) for piece in pieces)
        kinds = ((len(pieces) - boxes, kind), (boxes, "boxes for thin ones"))
        how = " and ".join(f"{n} {what}" for n, what in kinds if n)
        how += f"; {thick} were thickened to {1000 * THINNEST:.1f} mm" if thick else ""
    outside, beyond = piece_errors(mesh, pieces)
    return Pieces(tuple(pieces), outside, beyond, how)


def piece_mesh(piece: Piece) -> trimesh.Trimesh:
    """A collision piece as a mesh in [m]."""
    if isinstance(piece, CollisionBox):
        return trimesh.creation.box(piece.size, piece.T_part_box)
    if isinstance(piece, CollisionCylinder):
        return trimesh.creation.cylinder(piece.radius, piece.length, sections=48, transform=piece.T_part_cylinder)
    return trimesh.convex.convex_hull(piece.vertices)


def piece_errors(mesh: trimesh.Trimesh, pieces: Sequence[Piece]) -> tuple[float, float]:
    """Largest distances [m] of the solid beyond its pieces, and of the pieces beyond the solid."""
    meshes = [piece_mesh(piece) for piece in pieces]
    near = [Nearest(m.vertices, m.faces) for m in meshes]
    points = np.concatenate([trimesh.sample.sample_surface(mesh, SAMPLES, seed=2)[0], mesh.vertices])
    outside = np.min([n.signed(points) for n in near], axis=0).max()
    solid = Nearest(mesh.vertices, mesh.faces)
    beyond = [solid.signed(trimesh.sample.sample_surface(m, SAMPLES // 3, seed=2)[0]).max() for m in meshes]
    return max(float(outside), 0.0), max(float(np.max(beyond)), 0.0)


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


def _convex_parts(mesh: trimesh.Trimesh) -> tuple[list[Array], str]:
    """Corners of convex parts, and a description in words."""
    whole = trimesh.convex.convex_hull(mesh)
    if mesh.volume > FULL * whole.volume:
        return [np.asarray(whole.vertices)], "convex hull"
    straight = prism_pieces(mesh, MAX_PRISMS)
    return (straight, "prisms") if straight else (_coacd(mesh), "convex hulls")


def _hulls(parts: list[Array]) -> tuple[list[Piece], int]:
    """Hulls (thin ones replaced by boxes where these fit), and the number of thickened ones."""
    pieces: list[Piece] = []
    thick = 0
    for vertices in parts:
        corners = _few(vertices)
        box = _around(corners)
        if _sound(corners):
            pieces.append(CollisionHull(corners))
        elif float(np.prod(box.size)) < BOXY * ConvexHull(corners, qhull_options="QJ").volume:
            pieces.append(box)  # the physics keeps its margin within a box, however thin
        else:
            wide = _few(_thick(corners))
            thick += 1
            pieces.append(CollisionHull(wide) if _sound(wide) else box)
    return pieces, thick


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


def _coacd(mesh: trimesh.Trimesh) -> list[Array]:
    import coacd  # only a mesh that is neither box nor stack needs it

    coacd.set_log_level("off")
    scale = np.asarray(mesh.extents)
    parts = coacd.run_coacd(
        coacd.Mesh(np.asarray(mesh.vertices) / scale, np.asarray(mesh.faces)),
        threshold=THRESHOLD,
        max_convex_hull=MAX_HULLS,
        preprocess_mode="off",
        resolution=1000,
        mcts_iterations=60,
        mcts_nodes=12,
        max_ch_vertex=HULL_VERTICES,
        decimate=True,
        seed=0,
    )
    return [np.asarray(vertices) * scale for vertices, _ in parts]


def _thick(vertices: Array) -> Array:
    """Vertices of a hull that is thick enough: a thin one is widened about its middle along its thin direction."""
    centre = vertices.mean(axis=0)
    for _ in range(3):  # twice, because a splinter is thin in two directions
        hull = ConvexHull(vertices, qhull_options="QJ")
        widths = np.ptp(vertices @ hull.equations[:, :3].T, axis=0)
        thin = int(np.argmin(widths))
        if widths[thin] >= THINNEST:
            break
        normal = hull.equations[thin, :3]
        height = (vertices - centre) @ normal
        vertices = np.concatenate([vertices + np.outer(s * THINNEST / 2 - height, normal) for s in (-1.0, 1.0)])
    return vertices


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
