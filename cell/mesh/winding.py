"""Faces turned so that neighbours agree."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components

from pickproof.cell.mesh.checked import Checked
from pickproof.cell.mesh.edges import edge_keys, edges_of
from pickproof.cell.mesh.error import TornError

MANY_PIECES = 500
NORMALS = "one closed surface with outward normals"


def wind(mesh: Checked) -> None:
    """Turn faces so that neighbours agree; which side is out is for `one_body` to say.

    Raises:
        TornError: many pieces, or a surface with one side.
    """
    edges, keys = edges_of(mesh.faces), edge_keys(mesh.faces)
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
        raise TornError(f"{pieces} pieces of surface that do not hang together", NORMALS)
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
        raise TornError("a surface with one side only, as a Moebius strip", NORMALS)
    mesh.faces[turned] = mesh.faces[turned][:, ::-1]
    if turned.any():
        mesh.notes.append(f"turned {int(turned.sum())} faces that looked the other way from their neighbours")
