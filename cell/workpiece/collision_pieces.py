"""Collision pieces of a workpiece: boxes and cylinders where they fit, convex hulls where they do not.

The physics keeps its own margin around a hull, outside of its vertices; `without_margin` takes it off beforehand, so
that two hulls at rest touch where the CAD does.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import manifold3d as m3
import numpy as np
from pydantic import Field
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from pickproof.cell.config import Angles, Config, Length, OffsetPoint, Size, Small
from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, about_axis, from_rpy, make_transform
from pickproof.cell.mesh.error import MeshError
from pickproof.cell.mesh.obj import scan_obj

HULL_MARGIN = 0.001
"""[m] margin that Bullet keeps around a convex hull."""
MAX_HULL_VERTICES = 128
LAYER = 1e-4
"""[m] thickness of the middle layer of a thin plate."""
THICK = 1.25
"""Smallest radius of the largest inscribed ball of a hull, in margins."""

OFF_ROUND = 0.003
"""[m] largest distance of box corners from the cylinder that the boxes cover."""
LARGE, OFF_HULL, CUTS = 0.012, 0.004, 5
"""[m] corner distance of one box above which its hull is cut; [m] allowed corner distance of the boxes around the
pieces; largest number of halvings.
"""

Triple = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]


class CollisionBox(Config):
    """A solid box in the CAD frame: full edge lengths [m], centre [m], fixed-axis roll, pitch, yaw [rad]."""

    size: Size = Field(description="[m] full edge lengths")
    centre: OffsetPoint = Field(description="[m] in the CAD frame")
    rpy: Angles = Field((0.0, 0.0, 0.0), description="[rad] fixed-axis roll, pitch, yaw")

    @property
    def T_part_box(self) -> Array:
        """Pose (4, 4) of the box in the CAD frame."""
        return from_rpy(self.centre, self.rpy)


class CollisionCylinder(Config):
    """A solid cylinder about its own z axis: radius and length [m]; centre [m] and rpy [rad] in the CAD frame."""

    radius: Small = Field(description="[m]")
    length: Length = Field(description="[m] along its z axis")
    centre: OffsetPoint = Field(description="[m] in the CAD frame")
    rpy: Angles = Field((0.0, 0.0, 0.0), description="[rad] fixed-axis roll, pitch, yaw")

    @property
    def T_part_cylinder(self) -> Array:
        """Pose (4, 4) of the cylinder in the CAD frame; its axis is z."""
        return from_rpy(self.centre, self.rpy)


@dataclass(frozen=True, eq=False)
class CollisionHull:
    """The convex hull of `vertices` (n, 3) [m], all of them on it, in the CAD frame. Read-only."""

    vertices: Array

    def __post_init__(self) -> None:
        self.vertices.flags.writeable = False

    def without_margin(self, margin: float = HULL_MARGIN) -> Array:
        """Vertices (n, 3) moved inward so that a margin around them ends at the faces of this hull.

        Where corners are too sharp to be moved, as at a tooth's tip, those (m, 3) of all that is a margin inside. Of a
        plate thinner than two margins its middle layer, so that it becomes up to two margins thick.

        Raises:
            ValueError: the hull is thinner than one margin, or thinner than two in two directions.
        """
        hull = ConvexHull(self.vertices)
        normals, offsets = hull.equations[:, :3], hull.equations[:, 3]
        if np.ptp(self.vertices @ normals.T, axis=0).min() < 2 * margin + LAYER:
            return middle_layer(self.vertices, margin)
        moved = self.vertices.copy()
        for i in range(len(moved)):
            around = normals[(hull.simplices == i).any(axis=1)]
            # nearly parallel faces count as one, so that a vertex of a round hull moves by about the margin
            moved[i] -= margin * np.linalg.pinv(around, rcond=0.2) @ np.ones(len(around))
        if (moved @ normals.T + offsets).max() <= -0.5 * margin:
            return moved
        try:
            return eroded(self.vertices, margin)
        except ValueError:  # thicker than two margins by little
            return middle_layer(self.vertices, margin)


Piece = CollisionBox | CollisionCylinder | CollisionHull


def eroded(vertices: Array, margin: float) -> Array:
    """Corners (m, 3) of what lies `margin` [m] or more inside of all faces of the hull of vertices (n, 3).

    Raises:
        ValueError: the hull is hardly thicker than its margins.
    """
    planes = np.unique(ConvexHull(vertices).equations.round(12), axis=0)
    # the centre of the largest inscribed ball (Chebyshev centre) is the interior point of the search
    ball = linprog((0, 0, 0, -1), A_ub=np.column_stack([planes[:, :3], np.ones(len(planes))]), b_ub=-planes[:, 3],
                   bounds=[(None, None)] * 3 + [(0, None)])  # fmt: skip
    if ball.status != 0 or ball.x[3] < THICK * margin:
        raise ValueError(f"a hull is thinner than {2000 * THICK * margin:.1f} mm")
    inside = HalfspaceIntersection(np.add(planes, (0.0, 0.0, 0.0, margin)), ball.x[:3])
    corners = np.asarray(inside.intersections)
    return np.array(corners[ConvexHull(corners, qhull_options="QJ").vertices])


def middle_layer(vertices: Array, margin: float) -> Array:
    """Corners (m, 3) of a layer, LAYER thick, in the middle of a thin hull of (n, 3), a margin [m] off its rim.

    Raises:
        ValueError: the hull is thinner than a margin, or its layer is narrower than two.
    """
    normals = ConvexHull(vertices, qhull_options="QJ").equations[:, :3]
    heights = vertices @ normals.T
    thin = int(np.argmin(np.ptp(heights, axis=0)))
    normal, thickness = normals[thin], float(np.ptp(heights[:, thin]))
    if thickness < margin:
        raise ValueError(f"a hull is thinner than {1000 * margin:.1f} mm")
    u = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    axes = np.stack([u / np.linalg.norm(u), np.cross(normal, u / np.linalg.norm(u))])
    outline = m3.CrossSection.hull_points((1000 * vertices @ axes.T).tolist())
    inner = outline.offset(-1000 * margin, m3.JoinType.Miter).to_polygons()
    if len(inner) != 1:
        raise ValueError(f"a hull is thinner than {2000 * margin:.1f} mm in two directions")
    middle = heights[:, thin].min() + thickness / 2
    flat = 1e-3 * np.asarray(inner[0]) @ axes
    return np.concatenate([flat + (middle + side * LAYER / 2) * normal for side in (-1.0, 1.0)])


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
    return _box_around(np.asarray(piece.vertices))


def covering_boxes(piece: Piece) -> list[tuple[Triple, Array]]:
    """Boxes as in `enclosing_box` that cover a piece and extend beyond it by OFF_ROUND or OFF_HULL at most.

    A polygon of 2 n sides around a circle is the union of n rectangles, each from a side to the one opposite. A large
    hull is cut in halves until each box is close enough; a small hull gets one box.
    """
    if isinstance(piece, CollisionHull):
        corners = np.asarray(piece.vertices)
        return [_box_around(part) for part in (_halved(corners, CUTS) if _off(corners) > LARGE else [corners])]
    if isinstance(piece, CollisionBox):
        return [enclosing_box(piece)]
    r = piece.radius
    n = next(n for n in range(2, 100) if r / np.cos(np.pi / (2 * n)) - r <= OFF_ROUND)
    size = (2 * r, 2 * r * float(np.tan(np.pi / (2 * n))), piece.length)
    turns = about_axis((0, 0, 1), np.arange(n) * np.pi / n)
    return [(size, piece.T_part_cylinder @ turn) for turn in turns]


def _box_around(points: Array) -> tuple[Triple, Array]:
    low, high = points.min(axis=0), points.max(axis=0)
    x, y, z = (high - low).tolist()
    return (x, y, z), make_transform(t=(low + high) / 2)


def _off(points: Array) -> float:
    """Largest distance [m] of the corners of the box around points (n, 3) from their hull."""
    planes = ConvexHull(points, qhull_options="QJ").equations
    box = np.stack([points.min(axis=0), points.max(axis=0)], axis=1)
    corners = np.stack(np.meshgrid(*box, indexing="ij"), -1).reshape(-1, 3)
    return float((corners @ planes[:, :3].T + planes[:, 3]).max())


def _halved(points: Array, cuts: int) -> list[Array]:
    """Points (n, 3) of the convex solids that result when one is cut across its longest side."""
    if cuts == 0 or _off(points) <= OFF_HULL:
        return [points]
    hull = ConvexHull(points, qhull_options="QJ")
    low, high = points.min(axis=0), points.max(axis=0)
    axis = int(np.argmax(high - low))
    at = (low[axis] + high[axis]) / 2
    edges = points[hull.simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)]
    across = (edges[:, 0, axis] - at) * (edges[:, 1, axis] - at) < 0
    start, end = edges[across, 0], edges[across, 1]
    cut = start + (end - start) * ((at - start[:, axis]) / (end - start)[:, axis])[:, None]
    sides = (points[:, axis] <= at, points[:, axis] >= at)
    return [part for side in sides for part in _halved(np.concatenate([points[side], cut]), cuts - 1)]


def read_hulls(yaml_path: Path, path: Path, scale: float) -> tuple[CollisionHull, ...]:
    """Hulls from an OBJ file: each of its objects (`o` lines) is the convex hull of its vertices times `scale`.

    Raises:
        InputError: the file is missing or not an OBJ file, or a hull is flat, too thin or has too many vertices.
    """

    def bad(value: object, valid: str) -> InputError:
        return InputError(yaml_path, "collision_hulls", value, valid)

    try:
        found = scan_obj(path.read_bytes())
    except (OSError, MeshError) as error:
        said = error.found if isinstance(error, MeshError) else error
        raise bad(f"{path} ({said})", "a readable OBJ file") from None
    clouds = [cloud * scale for cloud in np.split(found.vertices, found.objects) if len(cloud)]
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
                what, f"a solid hull thicker than {1000 * HULL_MARGIN:.0f} mm (lengths are in mesh_unit)"
            ) from None
        if len(hull.vertices) > MAX_HULL_VERTICES:
            raise bad(what, f"at most {MAX_HULL_VERTICES} vertices on each hull")
        hulls.append(hull)
    return tuple(hulls)
