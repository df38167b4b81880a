"""The held part as the convex solids of its collision pieces."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from pickproof.cell.frames import Array, apply
from pickproof.cell.workpiece.collision_pieces import CollisionBox, CollisionCylinder, Piece, eroded

Shape = tuple[coal.CollisionGeometry, pin.SE3]
SPECK = 1e-4  # [m] edge that remains of a piece thinner than the tolerance


@dataclass(frozen=True, eq=False)
class HeldPart:
    """Collision pieces in their CAD frame, and its pose T (4, 4): T_tool_part or T_flange_part."""

    pieces: tuple[Piece, ...]
    T: Array

    def seen_from(self, T_a_b: Array) -> HeldPart:
        """The part expressed in frame a; it is given in frame b."""
        return HeldPart(self.pieces, T_a_b @ self.T)

    @property
    def corners(self) -> Array:
        """Points (n, 3) whose convex hull encloses the part, in the frame of the holder."""
        return apply(self.T, _corners(self.pieces))


@lru_cache(maxsize=16)
def shapes(pieces: tuple[Piece, ...], tolerance: float = 0.0) -> tuple[Shape, ...]:
    """One solid for each piece, in the CAD frame, reduced by `tolerance` [m] on all sides."""
    return tuple(_shape(piece, tolerance) for piece in pieces)


def _shape(piece: Piece, tolerance: float) -> Shape:
    if isinstance(piece, CollisionBox):
        edges = np.maximum(np.subtract(piece.size, 2 * tolerance), SPECK)
        return coal.Box(*edges.tolist()), pin.SE3(piece.T_part_box)
    if isinstance(piece, CollisionCylinder):
        radius, length = max(piece.radius - tolerance, SPECK), max(piece.length - 2 * tolerance, SPECK)
        return coal.Cylinder(radius, length), pin.SE3(piece.T_part_cylinder)
    try:
        corners = eroded(piece.vertices, tolerance) if tolerance else piece.vertices
    except (ValueError, QhullError):  # thinner than twice the tolerance
        return coal.Box(SPECK, SPECK, SPECK), pin.SE3(np.eye(3), piece.vertices.mean(axis=0))
    return _convex(corners), pin.SE3.Identity()


def _convex(corners: Array) -> coal.Convex:
    hull = ConvexHull(corners, qhull_options="QJ")
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    number = {int(v): i for i, v in enumerate(hull.vertices)}
    for v in hull.vertices:
        points.append(corners[v])
    for (a, b, c), plane in zip(hull.simplices, hull.equations, strict=True):
        normal = np.cross(corners[b] - corners[a], corners[c] - corners[a])
        order = (a, b, c) if normal @ plane[:3] > 0 else (a, c, b)
        triangles.append(coal.Triangle(*(number[int(v)] for v in order)))
    return coal.Convex(points, triangles)


@lru_cache(maxsize=16)
def _corners(pieces: tuple[Piece, ...]) -> Array:
    """Corners (n, 3) in the CAD frame; a cylinder counts as the box around it."""
    signs = np.array(list(np.ndindex(2, 2, 2))) - 0.5
    points = [np.zeros((0, 3))]
    for piece in pieces:
        if isinstance(piece, CollisionBox):
            points.append(apply(piece.T_part_box, signs * piece.size))
        elif isinstance(piece, CollisionCylinder):
            points.append(apply(piece.T_part_cylinder, signs * (2 * piece.radius, 2 * piece.radius, piece.length)))
        else:
            points.append(piece.vertices)
    corners = np.concatenate(points)
    return corners[ConvexHull(corners).vertices] if len(corners) > 8 else corners
