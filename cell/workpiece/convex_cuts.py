"""Convex pieces of any solid, by plane cuts until the hull of each piece is near enough to the solid.

The piece whose hull stands out of the solid the most is cut by the plane, of those of its faces and of some across its
sides, after which the hulls hold the least volume beside the solid. Faces of CAD parts are flat, so most cuts
run along them and the pieces are exact there. At last neighbours are joined whose common hull is near enough too.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, replace

import manifold3d as m3
import numpy as np
import trimesh

from pickproof.cell.frames import Array
from pickproof.cell.geometry.nearest import Nearest
from pickproof.cell.workpiece.piece_errors import reached

SAMPLES = 500
FACES, PLACES = 14, (0.2, 0.35, 0.5, 0.65, 0.8)
"""Planes of faces that are tried, the largest, and places along each axis."""
SLIVER = 1e-4
"""Share of a piece's volume below which what is cut off is left away."""
MOST_ADDED = 0.3
"""Share of the volume of two hulls that a common one may add."""
EVEN = 0.02
"""Weight of the largest hull against that of all: halves of a ring hold no less than the ring, their halves do."""
THIN = 0.001
"""[m] below which a piece is thinner than its margins in the physics."""
ALIKE = 5e-5
"""[m] within which a plane is the side of the piece."""


@dataclass(frozen=True)
class _Part:
    """A piece, its hull, how far [m] that stands out of the solid, and where (3,) the most."""

    body: m3.Manifold
    hull: m3.Manifold
    off: float
    worst: Array


def convex_cuts(mesh: trimesh.Trimesh, bound: float, most: int) -> list[Array]:
    """Corners (n, 3) [m] of at most `most` convex pieces of a closed mesh in [m], each off by `bound` [m] if that is
    enough of them."""
    solid = Nearest(mesh.vertices, mesh.faces)
    body = m3.Manifold(m3.Mesh64(np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.uint64)))
    least = SLIVER * body.volume()
    parts = [_part(piece, solid, bound) for piece in body.decompose() if piece.volume() > least]
    while len(parts) < most:
        worst = int(np.argmax([part.off for part in parts]))
        if parts[worst].off <= bound:
            break
        halves = _cut(parts[worst], least)
        if len(halves) < 2:
            parts[worst] = replace(parts[worst], off=0.0)  # nothing cuts it
            continue
        parts[worst : worst + 1] = [_part(piece, solid, bound) for piece in halves]
    return [_corners(part.hull) for part in _joined(parts, solid, bound)]


def _part(body: m3.Manifold, solid: Nearest, bound: float) -> _Part:
    hull = body.hull()
    return _Part(body, hull, *_off(hull, solid, bound))


def _off(hull: m3.Manifold, solid: Nearest, bound: float) -> tuple[float, Array]:
    made = hull.to_mesh64()
    mesh = trimesh.Trimesh(np.array(made.vert_properties[:, :3]), np.array(made.tri_verts), process=False)
    points = trimesh.sample.sample_surface(mesh, SAMPLES, seed=5)[0]
    off = reached(solid, points, solid.signed(points), bound)
    return float(off.max()), np.asarray(points[np.argmax(off)])


def _cut(part: _Part, least: float) -> list[m3.Manifold]:
    """The pieces by the best plane, of those that leave no thin ones if there are any; fewer than two if none cuts."""
    ways: list[tuple[float, list[m3.Manifold]]] = []
    through = [(axis, float(axis @ part.worst)) for axis in np.eye(3)]
    for normal, offset in through + _planes(part.body):
        halves = part.body.split_by_plane(normal.tolist(), offset)
        pieces = [p for half in halves for p in half.decompose() if p.volume() > least]
        if len(pieces) > 1 and all(half.volume() > least for half in halves):
            hulls = [p.hull().volume() for p in pieces]
            ways.append((sum(hulls) + EVEN * max(hulls), pieces))
    ways.sort(key=lambda way: way[0])
    for _, pieces in ways:
        if all(_thickness(p.hull()) > THIN for p in pieces):
            return pieces
    return ways[0][1] if ways else []


def _thickness(hull: m3.Manifold) -> float:
    """Least width [m] across one of its faces."""
    made = hull.to_mesh64()
    points, faces = np.array(made.vert_properties[:, :3]), np.array(made.tri_verts)
    corners = points[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-15)
    return float(np.ptp(points @ normals.T, axis=0).min())


def _planes(body: m3.Manifold) -> list[tuple[Array, float]]:
    made = body.to_mesh64()
    points, faces = np.array(made.vert_properties[:, :3]), np.array(made.tri_verts)
    corners = points[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(across, axis=1)
    good = areas > 0
    normals = across[good] / areas[good][:, None]
    offsets = np.einsum("ij,ij->i", normals, corners[good][:, 0])
    key = np.column_stack([normals.round(2), (offsets / (20 * ALIKE)).round()])
    _, first, which = np.unique(key, axis=0, return_index=True, return_inverse=True)
    weight = np.bincount(which.ravel(), areas[good])
    planes: list[tuple[Array, float]] = []
    for k in np.argsort(-weight, kind="stable"):
        normal, offset = normals[first[k]], float(offsets[first[k]])
        heights = points @ normal - offset
        if heights.min() < -ALIKE and heights.max() > ALIKE:
            planes.append((normal, offset))
        if len(planes) == FACES:
            break
    low, high = points.min(axis=0), points.max(axis=0)
    for axis in np.eye(3):
        planes += [(axis, float((low + share * (high - low)) @ axis)) for share in PLACES]
    return planes


def _joined(parts: list[_Part], solid: Nearest, bound: float) -> list[_Part]:
    """Neighbours made one whose common hull is near enough, those that add the least volume first."""
    left = dict(enumerate(parts))
    pairs = [pair for k in left for pair in _pairs(k, left) if pair[1] < pair[2]]
    heapq.heapify(pairs)
    while pairs:
        added, i, j = heapq.heappop(pairs)
        if i not in left or j not in left or added > MOST_ADDED * (left[i].hull.volume() + left[j].hull.volume()):
            continue
        hull = (left[i].hull + left[j].hull).hull()
        off, worst = _off(hull, solid, bound)
        if off <= bound:
            k = max(left) + 1
            left[k] = _Part(left.pop(i).body + left.pop(j).body, hull, off, worst)
            for pair in _pairs(k, left):
                heapq.heappush(pairs, pair)
    return list(left.values())


def _pairs(k: int, left: dict[int, _Part]) -> list[tuple[float, int, int]]:
    """Volume [m3] that the common hulls of part k with its neighbours add, and their numbers."""
    mine, low, high = left[k].hull, *_box(left[k].hull)
    found = []
    for i, other in left.items():
        its_low, its_high = _box(other.hull)
        if i != k and (low <= its_high + ALIKE).all() and (its_low <= high + ALIKE).all():
            added = (mine + other.hull).hull().volume() - mine.volume() - other.hull.volume()
            found.append((added, k, i))
    return found


def _box(body: m3.Manifold) -> tuple[Array, Array]:
    low, high = np.split(np.asarray(body.bounding_box()), 2)
    return low, high


def _corners(hull: m3.Manifold) -> Array:
    return np.array(hull.to_mesh64().vert_properties[:, :3])
