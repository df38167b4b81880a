"""Holes closed: flat ones whatever their size, uneven ones where they are small."""

from __future__ import annotations

import manifold3d as m3
import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.mesh.checked import Checked
from pickproof.cell.mesh.edges import alike, edge_keys, edges_of, open_edges
from pickproof.cell.mesh.error import MeshError, TornError, near

HOLE = 0.1
"""Share of the longest side up to which an uneven hole is closed; a flat one may have any size."""
FLAT = 0.02
"""Of a hole's size, within which its rim is flat."""


def fill(mesh: Checked) -> None:
    """Add faces over all holes.

    Raises:
        MeshError: a large hole whose rim is not flat, as of a shell.
        TornError: open edges that are the rim of no hole.
    """
    _, which = alike(edge_keys(mesh.faces))
    alone = np.bincount(which)[which] == 1
    rim = edges_of(mesh.faces)[alone][:, ::-1]  # the new faces run the other way
    size = float(np.ptp(mesh.vertices, axis=0).max())
    new, widths, vertices = [], [], [mesh.vertices]
    for loop in _loops(rim, mesh.vertices):
        points = mesh.vertices[loop]
        width = float(np.ptp(points, axis=0).max())
        centre = points.mean(axis=0)
        _, _, axes = np.linalg.svd(points - centre, full_matrices=False)
        off = float(np.abs((points - centre) @ axes[2]).max()) if len(points) > 3 else 0.0
        if off > FLAT * width and width > HOLE * size:
            raise MeshError(
                f"a hole of {1000 * width:.3g} mm {near(centre)} whose rim is not flat ({len(rim)} open edges in all)",
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
    if open_edges(mesh.faces):
        where = near(mesh.vertices[rim[0]])
        raise TornError(f"{len(rim)} open edges that do not close, one {where}", "a closed surface")


def _loops(rim: np.ndarray, vertices: Array) -> list[np.ndarray]:
    """Directed edges (k, 2) strung into closed loops of vertices (n, 3)."""
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
                where = near(vertices[[start, at]])
                raise TornError(f"{len(rim)} open edges that form no loops, some {where}", "a closed surface")
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
        width = 1000 * float(np.ptp(points, axis=0).max())
        raise TornError(f"a hole of {width:.3g} mm {near(centre)} with a crossed rim", "a closed surface")
    return faces
