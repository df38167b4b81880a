"""Faces of any number of corners made triangles that cover them, concave ones too.

The readers of trimesh fan a polygon out from its first corner, which leaves a concave one; so polygons are cut here,
by the ear clipping of manifold3d in the polygon's own plane.
"""

from __future__ import annotations

import manifold3d as m3
import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.mesh.error import MeshError

STRAIGHT = 1e-6
"""[rad] of turn below which a corner is straight: a fan over it would have triangles without area."""
OVERLAP = 1e-6
"""Share of a polygon's area by which its triangles may overlap."""


def triangulate(vertices: Array, corners: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Triangles (m, 3) over polygons, in their order and wound as they are.

    Args:
        vertices: (n, 3).
        corners: (k,) indices of vertices, polygon after polygon.
        sizes: (p,) number of corners of each polygon; below three it covers nothing.

    Raises:
        MeshError: a polygon whose outline crosses itself.
    """
    starts = np.cumsum(sizes) - sizes
    faces, owners = [np.zeros((0, 3), dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for n in np.unique(sizes[sizes >= 3]).tolist():
        mine = np.flatnonzero(sizes == n)
        polygons = corners[starts[mine][:, None] + np.arange(n)].astype(np.int64)
        faces.append(polygons if n == 3 else _cut(vertices, polygons))
        owners.append(np.repeat(mine, n - 2))
    return np.concatenate(faces)[np.argsort(np.concatenate(owners), kind="stable")]


def _cut(vertices: Array, polygons: np.ndarray) -> np.ndarray:
    """Triangles (k (n - 2), 3) over polygons (k, n)."""
    n = polygons.shape[1]
    fan = np.stack([np.zeros(n - 2, dtype=np.int64), np.arange(1, n - 1), np.arange(2, n)], axis=1)
    faces = polygons[:, fan]
    with np.errstate(all="ignore"):  # vertices that are no numbers come later to `check_mesh`
        points = vertices[polygons] - vertices[polygons[:, :1]]
        points = points / np.abs(points).max(axis=(1, 2), keepdims=True)
        normals = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)
        areas = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / areas
        convex = _strictly_convex(points, normals)
    flat = np.isfinite(points).all(axis=(1, 2)) & (areas[:, 0] > OVERLAP)
    for i in np.flatnonzero(~convex & flat):
        faces[i] = polygons[i][_clipped(points[i], normals[i], float(areas[i, 0]) / 2)]
    return faces.reshape(-1, 3)


def _strictly_convex(points: Array, normals: Array) -> np.ndarray:
    """(k,) bool: every corner of (k, n, 3) turns the same way about its normal (k, 3), once round in all."""
    edges = np.roll(points, -1, axis=1) - points
    after = np.roll(edges, -1, axis=1)
    across = np.einsum("kni,ki->kn", np.cross(edges, after), normals)
    turns = np.arctan2(across, np.einsum("kni,kni->kn", edges, after))
    return (turns > STRAIGHT).all(axis=1) & (np.abs(turns.sum(axis=1) - 2 * np.pi) < 1.0)


def _clipped(points: Array, normal: Array, area: float) -> np.ndarray:
    """Triangles (n - 2, 3) as places in the outline (n, 3) with this normal and area."""
    u = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    u /= np.linalg.norm(u)
    flat = np.ascontiguousarray(np.stack([points @ u, points @ np.cross(normal, u)], axis=1))
    faces = np.asarray(m3.triangulate([flat]), dtype=np.int64).reshape(-1, 3)
    a, b, c = (flat[faces[:, k]] for k in range(3))
    covered = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() / 2
    if len(faces) != len(points) - 2 or covered > area * (1 + OVERLAP) + OVERLAP:
        raise MeshError(f"a face of {len(points)} corners whose outline crosses itself", "faces with a simple outline")
    return faces
