"""Collision pieces of a workpiece: boxes and cylinders where they fit, convex hulls where they do not.

The physics keeps its own margin around a hull, outside of its vertices; `without_margin` takes it off beforehand, so
that two hulls at rest touch where the CAD does.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial import ConvexHull, QhullError

from cell.config import Config
from cell.errors import InputError
from cell.frames import Array, about_axis, from_rpy, make_transform

HULL_MARGIN = 0.001
"""[m] margin that Bullet keeps around a convex hull."""
MAX_HULL_VERTICES = 128

OFF_ROUND = 0.003
"""[m] that the corners of boxes may stand off the cylinder that they cover."""

Triple = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]


class CollisionBox(Config):
    """A solid box in the CAD frame: full edge lengths [m], centre [m], fixed-axis roll, pitch, yaw [rad]."""

    size: tuple[Positive, Positive, Positive]
    centre: Triple
    rpy: Triple = (0.0, 0.0, 0.0)

    @property
    def T_part_box(self) -> Array:
        return from_rpy(self.centre, self.rpy)


class CollisionCylinder(Config):
    """A solid cylinder about its own z axis: radius and length [m]; centre [m] and rpy [rad] in the CAD frame."""

    radius: Positive
    length: Positive
    centre: Triple
    rpy: Triple = (0.0, 0.0, 0.0)

    @property
    def T_part_cylinder(self) -> Array:
        return from_rpy(self.centre, self.rpy)


@dataclass(frozen=True)
class CollisionHull:
    """The convex hull of `vertices` (n, 3) [m], all of them on it, in the CAD frame. Read-only."""

    vertices: Array

    def __post_init__(self) -> None:
        self.vertices.flags.writeable = False

    def without_margin(self, margin: float = HULL_MARGIN) -> Array:
        """Vertices (n, 3) moved inward so that a margin around them ends at the faces of this hull.

        Raises:
            ValueError: the hull is thinner than its margins.
        """
        hull = ConvexHull(self.vertices)
        normals, offsets = hull.equations[:, :3], hull.equations[:, 3]
        moved = self.vertices.copy()
        for i in range(len(moved)):
            around = normals[(hull.simplices == i).any(axis=1)]
            # nearly parallel faces count as one, so a vertex of a round hull moves by the margin and not far more
            moved[i] -= margin * np.linalg.pinv(around, rcond=0.2) @ np.ones(len(around))
        if (moved @ normals.T + offsets).max() > -0.5 * margin:
            raise ValueError(f"a hull is thinner than {2000 * margin:.1f} mm")
        return moved


Piece = CollisionBox | CollisionCylinder | CollisionHull


def bounds(piece: Piece) -> tuple[Array, Array]:
    """Lowest and highest corner (3,), (3,) of a piece in the CAD frame."""
    if isinstance(piece, CollisionHull):
        return piece.vertices.min(axis=0), piece.vertices.max(axis=0)
    if isinstance(piece, CollisionBox):
        half = np.abs(piece.T_part_box[:3, :3]) @ np.asarray(piece.size) / 2
    else:
        axis = piece.T_part_cylinder[:3, 2]
        half = np.abs(axis) * piece.length / 2 + piece.radius * np.sqrt(np.clip(1 - axis**2, 0, None))
    return np.asarray(piece.centre) - half, np.asarray(piece.centre) + half


def enclosing_box(piece: Piece) -> tuple[Triple, Array]:
    """Full edge lengths [m] and T_part_box (4, 4) of a box around a piece."""
    if isinstance(piece, CollisionBox):
        return piece.size, piece.T_part_box
    if isinstance(piece, CollisionCylinder):
        return (2 * piece.radius, 2 * piece.radius, piece.length), piece.T_part_cylinder
    low, high = bounds(piece)
    x, y, z = (high - low).tolist()
    return (x, y, z), make_transform(t=(low + high) / 2)


def covering_boxes(piece: Piece) -> list[tuple[Triple, Array]]:
    """Boxes as in `enclosing_box` that together cover a piece; those of a cylinder stand off it by OFF_ROUND at most.

    A polygon of 2 n sides around a circle is the union of n rectangles, each from a side to the one opposite.
    """
    if not isinstance(piece, CollisionCylinder):
        return [enclosing_box(piece)]
    r = piece.radius
    n = next(n for n in range(2, 100) if r / np.cos(np.pi / (2 * n)) - r <= OFF_ROUND)
    size = (2 * r, 2 * r * float(np.tan(np.pi / (2 * n))), piece.length)
    turns = about_axis((0, 0, 1), np.arange(n) * np.pi / n)
    return [(size, piece.T_part_cylinder @ turn) for turn in turns]


def read_hulls(yaml_path: Path, path: Path, scale: float) -> tuple[CollisionHull, ...]:
    """Hulls from an OBJ file: each of its objects (`o` lines) is the convex hull of its vertices times `scale`.

    Raises:
        InputError: the file is missing or not such a file, or a hull is flat, too thin or has too many vertices.
    """

    def bad(value: object, valid: str) -> InputError:
        return InputError(yaml_path, "collision_hulls", value, valid)

    objects: list[list[list[float]]] = []
    try:
        for line in path.read_text(encoding="utf-8").splitlines():
            word, *rest = line.split() or [""]
            if word == "o" or (word == "v" and not objects):
                objects.append([])
            if word == "v":
                objects[-1].append([float(x) for x in rest[:3]])
        clouds = [np.asarray(vertices).reshape(-1, 3) * scale for vertices in objects if vertices]
    except (OSError, ValueError) as error:
        raise bad(f"{path} ({error})", "a readable OBJ file") from None
    if not clouds:
        raise bad(str(path), "an OBJ file with vertices")
    hulls = []
    for i, vertices in enumerate(clouds):
        what = f"{path}, object {i} of {len(vertices)} vertices"
        if not np.isfinite(vertices).all():
            raise bad(what, "finite vertices")
        try:
            hull = CollisionHull(vertices[ConvexHull(vertices).vertices])
            hull.without_margin()
        except (QhullError, ValueError):
            raise bad(
                what, f"a solid hull thicker than {2000 * HULL_MARGIN:.0f} mm (lengths are in mesh_unit)"
            ) from None
        if len(hull.vertices) > MAX_HULL_VERTICES:
            raise bad(what, f"at most {MAX_HULL_VERTICES} vertices on each hull")
        hulls.append(hull)
    return tuple(hulls)
