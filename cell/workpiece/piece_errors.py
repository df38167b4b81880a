"""How far collision pieces are off the solid that they stand for, both ways."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from pickproof.cell.frames import Array
from pickproof.cell.geometry.nearest import Nearest
from pickproof.cell.workpiece.collision_pieces import HULL_MARGIN, CollisionBox, CollisionCylinder, CollisionHull, Piece

BOUND = (0.0005, 0.02)
"""[m], and share of the longest side, by which pieces and part may be off each other; the larger counts."""
PROBE = 0.0025
"""[m] radius of the thinnest that touches a part: fingers are 5 mm thick. Where no such ball comes, as in a narrower
hole, pieces may stand out of the part."""
SAMPLES = 3000
_STEPS = np.array([0.25, 0.6, 1.0])


def error_bound(size: float) -> float:
    """[m] for a part with this longest side [m]."""
    return max(BOUND[0], BOUND[1] * size)


def piece_mesh(piece: Piece) -> trimesh.Trimesh:
    """A collision piece as a mesh in [m]."""
    if isinstance(piece, CollisionBox):
        return trimesh.creation.box(piece.size, piece.T_part_box)
    if isinstance(piece, CollisionCylinder):
        return trimesh.creation.cylinder(piece.radius, piece.length, sections=48, transform=piece.T_part_cylinder)
    return trimesh.convex.convex_hull(piece.vertices)


def widened(vertices: Array, width: float) -> Array:
    """Vertices (m, 3) of a hull at least `width` [m] thick: a thinner one is widened about its middle."""
    for _ in range(3):  # as a splinter is thin in two directions
        normals = ConvexHull(vertices, qhull_options="QJ").equations[:, :3]
        widths = np.ptp(vertices @ normals.T, axis=0)
        thin = int(np.argmin(widths))
        if widths[thin] >= width:
            break
        heights = vertices @ normals[thin]
        away = heights - (heights.min() + heights.max()) / 2
        vertices = np.concatenate([vertices + np.outer(s * width / 2 - away, normals[thin]) for s in (-1.0, 1.0)])
    return vertices


def _in_physics(piece: Piece) -> trimesh.Trimesh:
    """A piece as the physics has it: of a hull all that is a margin from the vertices that it is given."""
    if not isinstance(piece, CollisionHull):
        return piece_mesh(piece)
    ball = HULL_MARGIN * trimesh.creation.icosphere(subdivisions=2).vertices
    return trimesh.convex.convex_hull((piece.without_margin()[:, None] + ball).reshape(-1, 3))


def piece_errors(mesh: trimesh.Trimesh, pieces: Sequence[Piece]) -> tuple[float, float, float]:
    """How far [m] the solid sticks out of its pieces, they out of it, and they where a ball of PROBE comes."""
    meshes = [piece_mesh(piece) for piece in pieces]
    near = [Nearest(m.vertices, m.faces) for m in meshes]
    points = np.concatenate([trimesh.sample.sample_surface(mesh, SAMPLES, seed=2)[0], mesh.vertices])
    outside = np.min([n.signed(points) for n in near], axis=0).max()
    solid = Nearest(mesh.vertices, mesh.faces)
    shell = np.concatenate([trimesh.sample.sample_surface(_in_physics(p), SAMPLES // 3, seed=2)[0] for p in pieces])
    beyond = solid.signed(shell)
    felt = reached(solid, shell, beyond, BOUND[0])
    return max(float(outside), 0.0), max(float(beyond.max()), 0.0), max(float(felt.max(initial=0.0)), 0.0)


def reached(solid: Nearest, points: Array, distances: Array, above: float) -> Array:
    """Distances (n,) [m] out of a solid of points (n, 3), 0 for those above `above` where no ball of PROBE comes.

    A ball that holds the point, off the solid, is looked for with its middle along 42 directions from it.
    """
    found = np.array(distances)
    doubtful = np.flatnonzero(distances > above)
    if len(doubtful) == 0:
        return found
    ways = trimesh.creation.icosphere(subdivisions=1).vertices
    middles = points[doubtful][:, None, None] + PROBE * _STEPS[:, None, None] * ways
    room = solid.signed(middles.reshape(-1, 3)).reshape(len(doubtful), -1)
    found[doubtful[room.max(axis=1) < 0.97 * PROBE]] = 0.0
    return found
