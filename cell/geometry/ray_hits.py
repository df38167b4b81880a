"""Hits of rays made exact in float64, the same on every processor.

Embree casts in float32 with kernels and reciprocal estimates that depend on the processor. The last bits of a distance
differ between machines, and with them the choice between two triangles when a ray passes their common edge. Here the
distance is computed again from ray and triangle. Near an edge, the triangle is chosen again among all that share a
vertex with the one that Embree found.
"""

from __future__ import annotations

import numba
import numpy as np

from pickproof.cell.frames import Array

EDGE = 1e-6
"""Distance [m] to an edge within which the triangle is chosen again: several float32 rounding errors at 1 m."""


@numba.njit(cache=True)
def exact_hits(vertices, faces, origins, directions, found):  # type: ignore[no-untyped-def]
    """Distances t (n,) in lengths of the direction, infinite where nothing is hit, and triangles (n,), -1 there.

    Args:
        vertices: (k, 3) float64 [m]; faces: (m, 3) int64.
        origins: (n, 3) or (1, 3) for all [m]; directions: (n, 3) of any length.
        found: (n,) int64 triangle that Embree found, -1 for none.
    """
    first, incident = _incidence(len(vertices), faces)
    n = len(found)
    t, face = np.empty(n), found.copy()
    for i in range(n):
        if found[i] < 0:
            t[i] = np.inf
            continue
        o, d = _row(origins, i if len(origins) > 1 else 0), _row(directions, i)
        t[i], inside = _distance(vertices, faces, found[i], o, d)
        if inside < EDGE:
            face[i], t[i] = _nearest_around(vertices, faces, first, incident, o, d, found[i], t[i])
    return t, face


@numba.njit(cache=True)
def facing(vertices, faces, face, directions):  # type: ignore[no-untyped-def]
    """Unit normals (n, 3) of the triangles hit, turned against the rays, and the cosine of incidence (n,); 0 for -1."""
    n = len(face)
    normals, cosine = np.zeros((n, 3)), np.zeros(n)
    for i in range(n):
        if face[i] < 0:
            continue
        nx, ny, nz = _normal(vertices, faces, face[i])
        dx, dy, dz = _row(directions, i)
        along = nx * dx + ny * dy + nz * dz
        size = np.sqrt(nx * nx + ny * ny + nz * nz)
        if size < 1e-30:
            continue
        turned = -1.0 / size if along > 0 else 1.0 / size
        normals[i, 0], normals[i, 1], normals[i, 2] = nx * turned, ny * turned, nz * turned
        cosine[i] = abs(along) / (size * np.sqrt(dx * dx + dy * dy + dz * dz))
    return normals, cosine


def as_rays(origins: Array, directions: Array) -> tuple[Array, Array]:
    """Origins (n, 3) or (1, 3) and directions (n, 3) as the compiled loops take them."""
    return np.ascontiguousarray(np.atleast_2d(origins), np.float64), np.ascontiguousarray(directions, np.float64)


@numba.njit(cache=True)
def _incidence(n, faces):  # type: ignore[no-untyped-def]
    """The triangles at each vertex: those of vertex v are incident[first[v] : first[v + 1]], in order of index."""
    first = np.zeros(n + 1, np.int64)
    for f in range(len(faces)):
        for k in range(3):
            first[faces[f, k] + 1] += 1
    first = np.cumsum(first)
    filled, incident = first.copy(), np.empty(3 * len(faces), np.int64)
    for f in range(len(faces)):
        for k in range(3):
            incident[filled[faces[f, k]]] = f
            filled[faces[f, k]] += 1
    return first, incident


@numba.njit(cache=True)
def _nearest_around(vertices, faces, first, incident, o, d, found, t_found):  # type: ignore[no-untyped-def]
    """The nearest triangle hit among those that share a vertex with the found one; the found one if none is hit."""
    best, t_best = -1, np.inf
    for k in range(3):
        v = faces[found, k]
        for j in range(first[v], first[v + 1]):
            t, inside = _distance(vertices, faces, incident[j], o, d)
            if inside >= 0.0 and t > 0.0 and (t < t_best or (t == t_best and incident[j] < best)):
                best, t_best = incident[j], t
    return (best, t_best) if best >= 0 else (found, t_found)


@numba.njit(cache=True)
def _distance(vertices, faces, f, o, d):  # type: ignore[no-untyped-def]
    """Distance t to the plane of triangle f, and how far inside the triangle [m] the ray passes, negative outside.

    The side is the sign of the triple product of Moeller and Trumbore (1997) about the ray's origin. Each edge starts
    at its vertex of lower index, so two triangles agree on the side of their common edge.
    """
    i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
    a = _minus(_row(vertices, i), o)
    b = _minus(_row(vertices, j), o)
    c = _minus(_row(vertices, k), o)
    nx, ny, nz = _normal(vertices, faces, f)
    down = nx * d[0] + ny * d[1] + nz * d[2]
    if down == 0.0:
        return np.inf, -np.inf
    t = (nx * a[0] + ny * a[1] + nz * a[2]) / down
    # each triple product is twice the area of a side's triangle, seen along the ray, times the length of d
    area = np.sqrt(nx * nx + ny * ny + nz * nz) / abs(down)
    turn = 1.0 if down > 0.0 else -1.0
    inside = turn * area * _side(a, b, i < j, d) / _length(a, b)
    inside = min(inside, turn * area * _side(b, c, j < k, d) / _length(b, c))
    return t, min(inside, turn * area * _side(c, a, k < i, d) / _length(c, a))


@numba.njit(cache=True)
def _side(p, q, in_order, d):  # type: ignore[no-untyped-def]
    """d . (p x q), computed so that exchanging p and q changes exactly the sign."""
    if in_order:
        x, y, z = _cross(p, q)
        return x * d[0] + y * d[1] + z * d[2]
    x, y, z = _cross(q, p)
    return -(x * d[0] + y * d[1] + z * d[2])


@numba.njit(cache=True)
def _normal(vertices, faces, f):  # type: ignore[no-untyped-def]
    a = _row(vertices, faces[f, 0])
    return _cross(_minus(_row(vertices, faces[f, 1]), a), _minus(_row(vertices, faces[f, 2]), a))


@numba.njit(cache=True)
def _row(table, i):  # type: ignore[no-untyped-def]
    return table[i, 0], table[i, 1], table[i, 2]


@numba.njit(cache=True)
def _minus(p, q):  # type: ignore[no-untyped-def]
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


@numba.njit(cache=True)
def _cross(p, q):  # type: ignore[no-untyped-def]
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


@numba.njit(cache=True)
def _length(p, q):  # type: ignore[no-untyped-def]
    return max(np.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2), 1e-30)
