"""Vertices that are one made one, and faces left out that say nothing."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pickproof.cell.frames import Array
from pickproof.cell.mesh.checked import Checked
from pickproof.cell.mesh.edges import alike, edge_keys, edges_of, faces_at_edges, is_used, open_edges, packed
from pickproof.cell.mesh.error import MeshError

BAD_SHARE = 0.1
MOST_VERTICES = 2**21


def drop_not_numbers(mesh: Checked) -> None:
    """Leave out faces with coordinates that are no numbers.

    Raises:
        MeshError: a face has a corner that does not exist, or many are such.
    """
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise MeshError("a face with a corner that does not exist", "a mesh whose faces use its vertices")
    finite = np.asarray(np.isfinite(mesh.vertices).all(axis=1))
    bad = ~finite[mesh.faces].all(axis=1)
    if bad.mean() > BAD_SHARE:
        raise MeshError(f"{int(bad.sum())} of {len(bad)} faces with coordinates that are no numbers", "finite vertices")
    if bad.any():
        mesh.faces = mesh.faces[~bad]
        mesh.notes.append(f"removed {int(bad.sum())} faces with coordinates that are no numbers")


def weld(mesh: Checked, within: float) -> None:
    """Make vertices one that lie within a tolerance [m], and drop what is then no triangle, or the same as another.

    Raises:
        MeshError: more vertices than MOST_VERTICES.
    """
    used = np.flatnonzero(is_used(mesh.vertices, mesh.faces))
    points = mesh.vertices if len(used) == len(mesh.vertices) else mesh.vertices[used]
    cells = np.rint((points - points.min(axis=0)) / within).astype(np.int64)
    first, inverse = alike(packed(cells))
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
    if len(mesh.vertices) >= MOST_VERTICES:
        raise MeshError(f"{len(mesh.vertices)} vertices", f"at most {MOST_VERTICES}")
    mesh.faces = faces
    _drop_doubles(mesh)


def _drop_doubles(mesh: Checked) -> None:
    """Of faces with the same corners keep one; none of two that look opposite ways where bodies touch there."""
    first, which = alike(packed(np.sort(mesh.faces, axis=1)))
    if len(first) == len(mesh.faces):
        return
    a, b, c = mesh.faces.T
    looks = np.where((a < b) ^ (b < c) ^ (c < a), -1, 1)  # sign of the permutation that sorts the corners
    balance = np.bincount(which, looks)
    one = mesh.faces[np.sort(first)]
    none = mesh.faces[np.sort(first[balance != 0])]
    if len(none) < len(one) and len(none) and _odd_edges(none) < _odd_edges(one):
        walls = len(one) - len(none)
        mesh.notes.append(f"removed {walls} pairs of faces between bodies that touch there")
        doubles = len(mesh.faces) - len(none) - 2 * walls
        one = none
    else:
        doubles = len(mesh.faces) - len(one)
    if doubles:
        mesh.notes.append(f"removed {doubles} faces that were there twice")
    mesh.faces = one


def _odd_edges(faces: np.ndarray) -> int:
    return int((faces_at_edges(faces)[1] % 2 == 1).sum())


def weld_gaps(mesh: Checked, within: float) -> None:
    """Close seams: weld the vertices of open edges that lie within a tolerance [m]."""
    _, which = alike(edge_keys(mesh.faces))
    rim = np.unique(edges_of(mesh.faces)[np.bincount(which)[which] == 1])
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
    before, after = open_edges(mesh.faces), open_edges(faces)
    if after < before:
        mesh.faces = faces
        mesh.notes.append(f"welded {before - after} open edges along seams of up to {1000 * within:.3g} mm")


def extent(points: Array) -> float:
    """Longest side (of points (n, 3)) of the bounding box."""
    return float(np.ptp(points, axis=0).max())
