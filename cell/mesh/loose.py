"""Faces that bound nothing, as fins on a solid and sheets in it, left out where the rest is closed without them."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from pickproof.cell.frames import Array
from pickproof.cell.mesh.checked import Checked
from pickproof.cell.mesh.edges import alike, edge_keys, faces_at_edges
from pickproof.cell.mesh.error import near

SHEET = 1e-3
"""Of its area to the power of 1.5: volume between a patch and its middle, below which it is a sheet."""


def drop_loose(mesh: Checked) -> None:
    """Leave out patches with open edges that are flat, or hang on an edge of three faces, if no other edge is open."""
    label, n = _patches(mesh.faces)
    _, which = alike(edge_keys(mesh.faces))
    meeting = np.bincount(which)[which].reshape(-1, 3)
    is_open, hangs = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    is_open[label[(meeting == 1).any(axis=1)]] = True
    hangs[label[(meeting > 2).any(axis=1)]] = True
    loose = [k for k in np.flatnonzero(is_open) if hangs[k] or _is_sheet(mesh.vertices, mesh.faces[label == k])]
    gone = np.isin(label, loose)
    if not gone.any() or gone.all() or (faces_at_edges(mesh.faces[~gone])[1] % 2 == 1).any():
        return
    corners = mesh.vertices[mesh.faces[gone]]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = float(np.linalg.norm(across, axis=1).sum()) / 2
    mesh.faces = mesh.faces[~gone]
    mesh.notes.append(f"left out {int(gone.sum())} loose faces of {1e6 * area:.3g} mm2, some {near(corners[0])}")


def _patches(faces: np.ndarray) -> tuple[np.ndarray, int]:
    """Which patch each face (m,) is of, connected where two faces meet at an edge, and the number of patches."""
    keys = edge_keys(faces)
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.concatenate([[True], keys[order][1:] != keys[order][:-1]]))
    starts = starts[np.diff(np.append(starts, len(keys))) == 2]
    one, two = order[starts] // 3, order[starts + 1] // 3
    links = coo_matrix((np.ones(len(one)), (one, two)), shape=(len(faces), len(faces)))
    n, label = connected_components(links, directed=False)
    return label, int(n)


def _is_sheet(vertices: Array, faces: np.ndarray) -> bool:
    corners = vertices[faces] - vertices[faces].mean(axis=(0, 1))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = abs(float(np.einsum("ij,ij->", corners[:, 0], normals))) / 6
    return volume < SHEET * (float(np.linalg.norm(normals, axis=1).sum()) / 2) ** 1.5
