"""Edges of a triangle mesh, and how many faces meet at each."""

from __future__ import annotations

import numpy as np

from pickproof.cell.frames import Array


def packed(rows: np.ndarray) -> np.ndarray:
    """One integer (n,) for three below 2^21 each (n, 3)."""
    return np.asarray((rows[:, 0] << 42) | (rows[:, 1] << 21) | rows[:, 2])


def alike(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First place (k,) of every key in order of size, and which of them stands at each place (n,)."""
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    new = np.concatenate([np.ones(min(len(ordered), 1), bool), ordered[1:] != ordered[:-1]])
    inverse = np.empty(len(keys), dtype=np.int64)
    inverse[order] = np.cumsum(new) - 1
    return order[new], inverse


def edges_of(faces: np.ndarray) -> np.ndarray:
    """(3 m, 2): edge k of face i stands at 3 i + k."""
    return faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def edge_keys(faces: np.ndarray) -> np.ndarray:
    """(3 m,) the same for both directions of an edge."""
    a, b = edges_of(faces).T
    return np.asarray((np.minimum(a, b) << 32) | np.maximum(a, b))


def faces_at_edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The edges (k, 2) as pairs of vertices, and the number of faces (k,) at each."""
    first, which = alike(edge_keys(faces))
    return edges_of(faces)[first], np.bincount(which, minlength=len(first))


def open_edges(faces: np.ndarray) -> int:
    """Number of edges with one face."""
    return int((faces_at_edges(faces)[1] == 1).sum())


def is_closed(faces: np.ndarray) -> bool:
    """Every edge is run through as often one way as the other, so faces with normals outward bound a solid.

    More than two faces may meet at an edge: there the solid touches itself.
    """
    if len(faces) == 0:
        return False
    a, b = edges_of(faces).T
    _, which = alike(edge_keys(faces))
    return not np.bincount(which, np.where(a < b, 1, -1)).any()


def is_used(vertices: Array, faces: np.ndarray) -> np.ndarray:
    """(n,) bool: a face has the vertex as a corner. `np.unique` takes seconds for a million faces."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces.ravel()] = True
    return used
