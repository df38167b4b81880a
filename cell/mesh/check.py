"""A triangle mesh from anywhere made a closed surface with outward normals, or refused; what was done is said in words.

Lengths in [m]. Repairs keep the shape: what would have to be guessed is refused.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import manifold3d as m3
import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree

from pickproof.cell.frames import Array
from pickproof.cell.mesh.bodies import check_crossing, is_used, one_body
from pickproof.cell.mesh.error import MeshError

PART = (0.003, 2.0)
"""[m] longest side of parts that lie in bins."""
UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "um": 1e-6}
"""[m] of the units in which CAD is exported, likeliest first."""
RARE = 2.3
"""A unit that few use is named where the others are off by this in the logarithm of length."""
WELD = 1e-6
"""Vertices within this share of the longest side are one."""
GAP = 1e-4
"""Open edges are welded where their vertices lie within this share of the longest side."""
BAD_SHARE = 0.1
HOLE = 0.1
"""Share of the longest side up to which an uneven hole is closed; a flat one may have any size."""
FLAT = 0.02
"""Of a hole's size, within which its rim is flat."""
MANY_FACES = 20_000
MANY_PIECES = 500
COARSEST = (2e-4, 2e-3)
"""[m], and share of the longest side, by which a surface of many faces may move at most to lose some of them."""
NORMALS = "one closed surface with outward normals"


@dataclass
class Checked:
    """A closed mesh in [m], and what was done to it in words."""

    vertices: Array
    faces: np.ndarray
    notes: list[str] = field(default_factory=list)


def check_mesh(vertices: Array, faces: np.ndarray, unit: str) -> Checked:
    """Repair a mesh (n, 3) in `unit`, (m, 3).

    Raises:
        MeshError: it is empty, of a size that no part in a bin has, open, of several bodies, or passes through itself.
    """
    if len(faces) == 0 or len(vertices) == 0:
        raise MeshError("no faces", "a mesh with faces")
    mesh = Checked(np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64))
    _drop_not_numbers(mesh)
    size = float(np.ptp(mesh.vertices[is_used(mesh.vertices, mesh.faces)], axis=0).max())
    check_size(size, unit)
    mesh.vertices = mesh.vertices * UNITS[unit]
    _weld(mesh, WELD * size * UNITS[unit])
    if len(mesh.faces) == 0:
        raise MeshError("only faces without area", "a mesh with faces")
    if _open_edges(mesh.faces):
        _weld_gaps(mesh, GAP * size * UNITS[unit])
    _wind(mesh)
    if _open_edges(mesh.faces):
        _fill(mesh)
        _wind(mesh)
    crowded = int((_meeting(mesh.faces) > 2).sum())
    if crowded:
        raise MeshError(f"{crowded} edges with more than two faces", "a surface on which two faces meet at every edge")
    mesh.vertices, mesh.faces, notes = one_body(mesh.vertices, mesh.faces)
    mesh.notes += notes
    _coarsen(mesh)
    check_crossing(mesh.vertices, mesh.faces)
    return mesh


def check_size(longest: float, unit: str) -> None:
    """Question a longest side in `unit` that no part in a bin has.

    Raises:
        MeshError: it names the unit that is meant in all likelihood.
    """
    if not np.isfinite(longest) or longest <= 0:
        raise MeshError(f"a longest side of {longest:g}", "a mesh with an extent")
    low, high = PART
    if low <= longest * UNITS[unit] <= high:
        return

    def off(name: str) -> float:
        length = longest * UNITS[name]
        return max(np.log(low / length), np.log(length / high), 0.0) + (RARE if name == "um" else 0.0)

    valid, likely = f"a part of {1000 * low:g} mm to {high:g} m", min(UNITS, key=off)
    if likely != unit:
        valid += f"; as --unit {likely} it would be {_length(longest * UNITS[likely])} long"
    raise MeshError(f"{_length(longest * UNITS[unit])} long (--unit {unit})", valid)


def _length(metres: float) -> str:
    return f"{metres:.4g} m" if metres >= 2 else f"{1000 * metres:.4g} mm"


def _drop_not_numbers(mesh: Checked) -> None:
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise MeshError("a face with a corner that does not exist", "a mesh whose faces use its vertices")
    finite = np.asarray(np.isfinite(mesh.vertices).all(axis=1))
    bad = ~finite[mesh.faces].all(axis=1)
    if bad.mean() > BAD_SHARE:
        raise MeshError(f"{int(bad.sum())} of {len(bad)} faces with coordinates that are no numbers", "finite vertices")
    if bad.any():
        mesh.faces = mesh.faces[~bad]
        mesh.notes.append(f"removed {int(bad.sum())} faces with coordinates that are no numbers")


def _weld(mesh: Checked, within: float) -> None:
    """Make vertices one that lie within a tolerance [m], and drop what is then no triangle, or the same as another."""
    used = np.flatnonzero(is_used(mesh.vertices, mesh.faces))
    points = mesh.vertices if len(used) == len(mesh.vertices) else mesh.vertices[used]
    cells = np.rint((points - points.min(axis=0)) / within).astype(np.int64)
    first, inverse = _alike(_packed(cells))
    to = inverse
    if points is not mesh.vertices:
        to = np.full(len(mesh.vertices), -1)
        to[used] = inverse
    mesh.vertices, faces = points[first], to[mesh.faces]
    a, b, c = faces.T
    solid = (a != b) & (b != c) & (c != a)
    if not solid.all():
        mesh.notes.append(f"removed {int((~solid).sum())} faces without area")
        faces = faces[solid]
    if len(mesh.vertices) >= 2**21:
        raise MeshError(f"{len(mesh.vertices)} vertices", f"at most {2**21}")
    first, _ = _alike(_packed(np.sort(faces, axis=1)))
    if len(first) < len(faces):
        mesh.notes.append(f"removed {len(faces) - len(first)} faces that were there twice")
        faces = faces[np.sort(first)]
    mesh.faces = faces


def _packed(rows: np.ndarray) -> np.ndarray:
    """One integer (n,) for three below 2^21 each (n, 3)."""
    return (rows[:, 0] << 42) | (rows[:, 1] << 21) | rows[:, 2]


def _alike(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First place (k,) of every key in order of size, and which of them stands at each place (n,)."""
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    new = np.concatenate([[True], ordered[1:] != ordered[:-1]])
    inverse = np.empty(len(keys), dtype=np.int64)
    inverse[order] = np.cumsum(new) - 1
    return order[new], inverse


def _edges(faces: np.ndarray) -> np.ndarray:
    """(3 m, 2): edge k of face i stands at 3 i + k."""
    return faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def _edge_keys(faces: np.ndarray) -> np.ndarray:
    """(3 m,) the same for both directions of an edge."""
    a, b = _edges(faces).T
    return (np.minimum(a, b) << 32) | np.maximum(a, b)


def _meeting(faces: np.ndarray) -> np.ndarray:
    """Number of faces (k,) at each edge."""
    keys = np.sort(_edge_keys(faces))
    starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    return np.diff(np.append(starts, len(keys)))


def _open_edges(faces: np.ndarray) -> int:
    return int((_meeting(faces) == 1).sum())


def _weld_gaps(mesh: Checked, within: float) -> None:
    """Close seams: weld the vertices of open edges that lie within a tolerance [m]."""
    _, which = _alike(_edge_keys(mesh.faces))
    rim = np.unique(_edges(mesh.faces)[np.bincount(which)[which] == 1])
    pairs = cKDTree(mesh.vertices[rim]).query_pairs(within, output_type="ndarray")
    if len(pairs) == 0:
        return
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(rim), len(rim)))
    _, label = connected_components(links, directed=False)
    to = np.arange(len(mesh.vertices))
    to[rim] = rim[np.unique(label, return_index=True)[1]][label]
    faces = to[mesh.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    before, after = _open_edges(mesh.faces), _open_edges(faces)
    if after < before:
        mesh.faces = faces
        mesh.notes.append(f"welded {before - after} open edges along seams of up to {1000 * within:.3g} mm")


def _wind(mesh: Checked) -> None:
    """Turn faces so that neighbours agree; which side is out is for `one_body` to say."""
    edges, keys = _edges(mesh.faces), _edge_keys(mesh.faces)
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.concatenate([[True], keys[order][1:] != keys[order][:-1]]))
    starts = starts[np.diff(np.append(starts, len(keys))) == 2]
    one, two = order[starts], order[starts + 1]
    clash = edges[one, 0] == edges[two, 0]  # both run the same way: one of the faces is turned
    if not clash.any():
        return
    n = len(mesh.faces)
    # parity as data: 1 agrees, 2 clashes; zeros would not be stored
    graph = coo_matrix((1.0 + clash, (one // 3, two // 3)), shape=(n, n)).tocsr()
    graph = graph + graph.T
    turned = np.zeros(n, dtype=bool)
    pieces, label = connected_components(graph, directed=False)
    if pieces > MANY_PIECES:
        raise MeshError(f"{pieces} pieces of surface that do not hang together", NORMALS)
    for start in np.unique(label, return_index=True)[1]:
        visited, before = breadth_first_order(graph, start, directed=False)
        if len(visited) == 1:  # scipy returns another type for no places
            continue
        parity = np.asarray(graph[before[visited[1:]], visited[1:]]).ravel() > 1.5
        for i, flips in zip(visited[1:], parity, strict=True):
            turned[i] = turned[before[i]] ^ flips
    minority = np.bincount(label, turned) > np.bincount(label) / 2
    turned ^= minority[label]
    if (turned[one // 3] ^ turned[two // 3] ^ clash).any():
        raise MeshError("a surface with one side only, as a Moebius strip", NORMALS)
    mesh.faces[turned] = mesh.faces[turned][:, ::-1]
    if turned.any():
        mesh.notes.append(f"turned {int(turned.sum())} faces that looked the other way from their neighbours")


def _fill(mesh: Checked) -> None:
    """Close holes: flat ones whatever their size, uneven ones where they are small."""
    _, which = _alike(_edge_keys(mesh.faces))
    alone = np.bincount(which)[which] == 1
    rim = _edges(mesh.faces)[alone][:, ::-1]  # the new faces run the other way
    size = float(np.ptp(mesh.vertices, axis=0).max())
    new, widths, vertices = [], [], [mesh.vertices]
    for loop in _loops(rim):
        points = mesh.vertices[loop]
        width = float(np.ptp(points, axis=0).max())
        centre = points.mean(axis=0)
        _, _, axes = np.linalg.svd(points - centre, full_matrices=False)
        off = float(np.abs((points - centre) @ axes[2]).max()) if len(points) > 3 else 0.0
        if off > FLAT * width and width > HOLE * size:
            raise MeshError(
                f"a hole of {1000 * width:.3g} mm whose rim is not flat ({len(rim)} open edges in all)",
                "a closed surface; a shell needs its thickness modelled",
            )
        widths.append(width)
        if off > FLAT * width:
            new.append(np.stack([loop, np.roll(loop, -1), np.full(len(loop), sum(map(len, vertices)))], axis=1))
            vertices.append(centre[None])
        else:
            new.append(loop[_flat_faces(points, centre, axes)])
    mesh.vertices, mesh.faces = np.concatenate(vertices), np.concatenate([mesh.faces, *new])
    mesh.notes.append(f"closed {len(widths)} holes, the widest of {1000 * max(widths):.3g} mm")
    if _open_edges(mesh.faces):
        raise MeshError(f"{len(rim)} open edges that do not close", "a closed surface; a shell needs its thickness")


def _loops(rim: np.ndarray) -> list[np.ndarray]:
    """Directed edges (k, 2) strung into closed loops of vertices."""
    after: dict[int, list[int]] = {}
    for a, b in rim.tolist():
        after.setdefault(a, []).append(b)
    loops = []
    while after:
        start = next(iter(after))
        loop, at = [], start
        while True:
            loop.append(at)
            ways = after.get(at)
            if not ways:
                raise MeshError(f"{len(rim)} open edges that form no loops", "a closed surface")
            following = ways.pop()
            if not ways:
                del after[at]
            at = following
            if at == start:
                break
        loops.append(np.array(loop))
    return loops


def _flat_faces(points: Array, centre: Array, axes: Array) -> np.ndarray:
    """Triangles (k, 3) over a flat loop of points (n, 3), turned as the loop runs."""
    flat = (points - centre) @ axes[:2].T
    x, y = flat.T
    backwards = float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) < 0
    if backwards:
        flat = flat * (1.0, -1.0)
    faces = np.asarray(m3.triangulate([np.ascontiguousarray(flat)]), dtype=np.int64).reshape(-1, 3)
    if len(faces) != len(points) - 2:
        raise MeshError(
            f"a hole of {1000 * np.ptp(points, axis=0).max():.3g} mm with a crossed rim", "a closed surface"
        )
    return faces


def _coarsen(mesh: Checked) -> None:
    """Leave out faces where the surface moves by little, until few are left; rays and contacts cost time for each."""
    n, size = len(mesh.faces), float(np.ptp(mesh.vertices, axis=0).max())
    if n <= MANY_FACES:
        return
    body = m3.Manifold(m3.Mesh64(mesh.vertices, mesh.faces.astype(np.uint64)))
    coarsest, moved = max(COARSEST[0], COARSEST[1] * size), 0.0
    for step in coarsest * np.array([0.02, 0.08, 0.2, 0.7]):
        body, moved = body.simplify(step), moved + step
        if body.num_tri() <= MANY_FACES:
            break
    made = body.to_mesh64()
    mesh.vertices, mesh.faces = np.asarray(made.vert_properties)[:, :3], np.asarray(made.tri_verts, dtype=np.int64)
    left = len(mesh.faces)
    if left > 3 * MANY_FACES:
        raise MeshError(
            f"{n} faces, {left} of them needed to stay within {1000 * coarsest:.2g} mm",
            f"a surface smooth enough for {3 * MANY_FACES} faces; a scan wants smoothing first",
        )
    mesh.notes.append(f"{n} faces made {left}; the surface moved by {1000 * moved:.2g} mm at most")


def as_trimesh(checked: Checked) -> trimesh.Trimesh:
    """The mesh in [m]."""
    return trimesh.Trimesh(checked.vertices, checked.faces, process=False)
