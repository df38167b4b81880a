"""Snapping of a dragged grasp to features of the CAD, and mirroring at its planes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, make_transform
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.grasp_points import GraspPoint, Turn

NEAR = 0.002  # [m] within which a position snaps
ALIGN_DEG = 12.0  # within which a direction snaps
SHARP_DEG = 30.0  # between two triangles that meet in an edge
EDGE_STEP = 0.001  # [m] between points of an edge
STILL = 1e-5  # [m, and of directions] that is no movement
SAMPLES = 8000
MIRRORED = 3e-4  # [m] that a mirrored point may be off the surface
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Plane:
    """A plane of the CAD frame: unit `normal` (3,) and `offset` [m] along it; `name` says which to the user."""

    name: str
    normal: tuple[float, float, float]
    offset: float = 0.0


@dataclass(frozen=True)
class Snapping:
    """Kinds of features to which a dragged grasp snaps."""

    normals: bool = True
    edges: bool = False
    centre_planes: bool = True
    symmetry_planes: bool = True


@dataclass(frozen=True)
class SnapTargets:
    """The snap features of one workpiece; build it once with `of`."""

    workpiece: Workpiece
    points: Array
    normals: Array
    tree: cKDTree = field(repr=False)
    edges: Array = field(repr=False)
    edge_directions: Array = field(repr=False)
    centre_planes: tuple[Plane, ...] = ()
    symmetry_planes: tuple[Plane, ...] = ()

    @staticmethod
    def of(workpiece: Workpiece) -> SnapTargets:
        """Of points on a workpiece's surface."""
        points, normals = workpiece.sample_surface(SAMPLES, seed=7)
        tree = cKDTree(points)
        edges, directions = _sharp_edges(workpiece)
        return SnapTargets(
            workpiece, points, normals, tree, edges, directions, _centre_planes(workpiece),
            tuple(p for p in _candidates(workpiece) if _is_mirror(p, points, normals, tree)),
        )  # fmt: skip

    def snap(self, T_part_grip: Array, to: Snapping, start: Array | None = None) -> Array:
        """The grip frame (4, 4), x closing and z approach, moved to what lies near; itself where nothing does.

        Args:
            start: (4, 4) at the start of the drag; rotation or position that the drag did not change is kept.
        """
        planes = [
            *(self.centre_planes if to.centre_planes else ()),
            *(self.symmetry_planes if to.symmetry_planes else ()),
        ]
        t = T_part_grip[:3, 3].copy()
        x, z = T_part_grip[:3, 0], T_part_grip[:3, 2]
        if start is None or np.abs(T_part_grip[:3, :3] - start[:3, :3]).max() > STILL:
            x, z = self._snapped_directions(t, x, z, to, planes)
        way = np.full(3, np.inf) if start is None else t - start[:3, 3]
        for plane in planes:
            n = np.asarray(plane.normal)
            off = float(t @ n) - plane.offset
            if abs(off) < NEAR and (start is None or abs(way @ n) > STILL):
                t -= off * n
        if to.edges and len(self.edges) and np.abs(way).max() > STILL:
            nearest = self.edges[int(np.argmin(np.linalg.norm(self.edges - t, axis=1)))]
            t = nearest if np.linalg.norm(nearest - t) < NEAR else t
        return grip_frame(t, z, x)

    def _snapped_directions(
        self, t: Array, x: Array, z: Array, to: Snapping, planes: Sequence[Plane]
    ) -> tuple[Array, Array]:
        """Closing and approach (3,) turned to normals of the surface, of planes, and to edges."""
        directions = [np.asarray(p.normal) for p in planes]
        if to.edges:
            directions += list(self.edge_directions)
        if to.normals:
            x = _aligned(x, self._normals_along(t, x))
        x = _aligned(x, directions)
        z = _aligned(z - (z @ x) * x, directions)
        return x, z - (z @ x) * x

    def _normals_along(self, centre: Array, closing: Array) -> list[Array]:
        """Normals of the surface nearest to where the closing line leaves the workpiece on either side."""
        along = (self.points - centre) @ closing
        away = np.linalg.norm(self.points - centre - along[:, None] * closing, axis=1)
        near = np.flatnonzero(away < 3 * NEAR)
        if len(near) == 0:
            near = np.array([int(self.tree.query(centre)[1])])
        facing = near[np.abs(self.normals[near] @ closing) > np.cos(np.deg2rad(ALIGN_DEG))]
        return [self.normals[i] for i in facing[np.argsort(np.abs(along[facing]))][:1]]


def grip_frame(centre: Array, approach: Array, closing: Array) -> Array:
    """T_part_grip (4, 4): z along `approach`, x along `closing` made square to it."""
    z = np.asarray(approach) / np.linalg.norm(approach)
    x = np.asarray(closing) - (np.asarray(closing) @ z) * z
    x /= np.linalg.norm(x)
    return make_transform(np.stack([x, np.cross(z, x), z], axis=1), centre)


def frame_of(point: GraspPoint) -> Array:
    """T_part_grip (4, 4) of a grasp point."""
    return grip_frame(np.asarray(point.centre), np.asarray(point.approach), np.asarray(point.closing))


def fields_of(T_part_grip: Array) -> dict[str, tuple[float, ...]]:
    """Fields of a grasp point for a grip frame, as far as a file needs them: to 1 um and 1e-6."""
    fields = {"centre": T_part_grip[:3, 3], "approach": T_part_grip[:3, 2], "closing": T_part_grip[:3, 0]}
    return {name: tuple(round(float(v), 6) + 0.0 for x in [value] for v in x) for name, value in fields.items()}


def squared(point: GraspPoint, fields: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
    """Where one of approach and closing is set, the other one, turned to a right angle with it; else nothing."""
    if ("approach" in fields) == ("closing" in fields):
        return {}
    set_one, other = ("approach", "closing") if "approach" in fields else ("closing", "approach")
    kept, turned = np.array(fields[set_one], float), np.array(getattr(point, other), float)
    if np.linalg.norm(kept) < 1e-6:
        return {}  # refused by the schema
    kept /= np.linalg.norm(kept)
    square = turned - (turned @ kept) * kept
    if np.linalg.norm(square) < 1e-3:
        square = np.cross(kept, np.eye(3)[int(np.argmin(np.abs(kept)))])
    return {other: tuple(round(float(v), 6) + 0.0 for v in square / np.linalg.norm(square))}


def mirrored(point: GraspPoint, plane: Plane, name: str) -> GraspPoint:
    """The grasp on the other side of a plane; the tool is alike on both sides, so its turns only change their sign.

    Raises:
        InputError: the part turns about an axis through the origin, which the plane does not pass through.
    """
    if plane.offset and len(point.part_rotation.angles()) > 1:
        raise InputError("page", "mirror at", plane.name, "a plane through the CAD origin, for `part_rotation` is set")
    n = np.asarray(plane.normal)
    M = np.eye(3) - 2 * np.outer(n, n)

    def direction(v: tuple[float, float, float]) -> tuple[float, ...]:
        return tuple(round(float(x), 9) + 0.0 for x in M @ v)

    centre = M @ point.centre + 2 * plane.offset * n
    update: dict[str, object] = {
        "name": name,
        "centre": tuple(round(float(x), 9) + 0.0 for x in centre),
        "approach": direction(point.approach),
        "closing": direction(point.closing),
        "part_axis": direction(point.part_axis),
        "tool_rotation": _reversed(point.tool_rotation),
        "approach_rotation": _reversed(point.approach_rotation),
        "part_rotation": _reversed(point.part_rotation),
    }
    if point.slide is not None:
        update["slide"] = point.slide.model_copy(update={"along": direction(point.slide.along)})
    return point.model_copy(update=update)


def _reversed(turn: Turn) -> Turn:
    return turn.model_copy(update={"from_deg": -turn.to_deg + 0.0, "to_deg": -turn.from_deg + 0.0})


def _aligned(v: Array, directions: list[Array]) -> Array:
    """`v` as a unit vector, or the direction of either sign that lies within ALIGN_DEG of it, nearest first."""
    v = v / np.linalg.norm(v)
    if not directions:
        return v
    cosines = np.array([d @ v / np.linalg.norm(d) for d in directions])
    best = int(np.argmax(np.abs(cosines)))
    if abs(cosines[best]) < np.cos(np.deg2rad(ALIGN_DEG)):
        return v
    return np.asarray(np.sign(cosines[best]) * directions[best] / np.linalg.norm(directions[best]))


def _centre_planes(workpiece: Workpiece) -> tuple[Plane, ...]:
    """Through the middle of the bounding box, and through the centre of mass where that is elsewhere."""
    planes = [Plane(f"middle {a}", tuple(np.eye(3)[i])) for i, a in enumerate(AXES)]
    for i, a in enumerate(AXES):
        if abs(workpiece.com[i]) > NEAR:
            planes.append(Plane(f"centre of mass {a}", tuple(np.eye(3)[i]), float(workpiece.com[i])))
    return tuple(planes)


def _candidates(workpiece: Workpiece) -> list[Plane]:
    """Planes at which the CAD may be its own mirror image: square to each axis, and through those of symmetry."""
    found = [Plane(f"mirror {a}", tuple(np.eye(3)[i])) for i, a in enumerate(AXES)]
    for i, degrees in enumerate(workpiece.symmetry.degrees):
        half = max(degrees / 2, 15.0) if degrees else 180.0
        for angle in np.arange(half, 180.0 - 1e-9, half):
            x, y, z = np.roll([0.0, np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))], i).tolist()
            if max(abs(x), abs(y), abs(z)) < 1 - 1e-9:
                found.append(Plane(f"mirror {angle:g} deg about {AXES[i]}", (x, y, z)))
    return found


def _is_mirror(plane: Plane, points: Array, normals: Array, tree: cKDTree) -> bool:
    """Nearly all mirrored samples lie on the surface, measured at right angles to it."""
    n = np.asarray(plane.normal)
    M = np.eye(3) - 2 * np.outer(n, n)
    images, facing = points[::4] @ M, normals[::4] @ M
    _, nearest = tree.query(images, k=8)
    off = np.abs(np.einsum("ikj,ikj->ik", images[:, None] - points[nearest], normals[nearest]))
    off[np.einsum("ij,ikj->ik", facing, normals[nearest]) < 0.9] = np.inf
    return bool(np.mean(off.min(axis=1) < MIRRORED) > 0.97)


def _sharp_edges(workpiece: Workpiece) -> tuple[Array, Array]:
    """Points (n, 3) along the sharp edges of the CAD, and the few directions (k, 3) that most of their length has."""
    mesh = workpiece.mesh.copy()
    mesh.merge_vertices()
    ends = mesh.vertices[mesh.face_adjacency_edges[mesh.face_adjacency_angles > np.deg2rad(SHARP_DEG)]]
    if len(ends) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3))
    span = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(span, axis=1)
    steps = np.maximum(np.ceil(length / EDGE_STEP).astype(int), 1)
    points = [a + s * np.linspace(0, 1, k + 1)[:, None] for a, s, k in zip(ends[:, 0], span, steps, strict=True)]
    directions: list[Array] = []
    for i in np.argsort(-length)[:200]:
        d = span[i] / max(length[i], 1e-12)
        if length[i] > 0.05 * length.max() and not any(abs(d @ e) > 0.999 for e in directions):
            directions.append(d)
    return np.concatenate(points), np.asarray(directions[:12])
