"""Convex pieces of a solid that is a stack of straight layers, as gears, profiles and cut plates are.

A layer is a plane figure extruded along an axis. Each figure is covered by convex polygons that may overlap: a polygon
grows from a triangle of the figure as long as its hull stays inside, and the smallest set that covers all is chosen. So
the piece of a tooth extends into its wheel instead of being a splinter, and the pieces follow the outline to `SLACK`.
"""

from __future__ import annotations

from collections.abc import Iterator

import manifold3d as m3
import numpy as np
import trimesh

from pickproof.cell.frames import Array

STRAIGHT = float(np.sin(np.deg2rad(0.6)))
"""Sine of the angle to the axis, or to its normal plane, up to which a face counts as straight."""
ALL_STRAIGHT = 0.999
"""Share of the surface that must be straight."""
SLACK = (0.1, 0.2, 0.4)
"""[mm] allowed deviations of pieces from a figure; the smallest that keeps the allowed number of pieces is used."""
BORE = 12.0
"""[mm] diameter below which a hole is filled: no finger fits in."""
LEVEL, FINE = 0.01, 0.02
"""[mm] distance of layers that count as one, and size of detail that is left out."""
EMPTY = 1e-4
"""[mm2] area that counts as 0."""
MOST = 200
"""Number of triangles of one figure above which the solid is not treated as a stack of layers."""


def prism_pieces(mesh: trimesh.Trimesh, most: int) -> list[Array]:
    """Corners (n, 3) [m] of at most `most` convex pieces of a closed mesh in [m]; empty where it is no such stack."""
    for axis in range(3):
        to_z = np.roll(np.eye(3), 2 - axis, axis=0)
        up = mesh.face_normals @ to_z[2]
        straight = (np.abs(up) < STRAIGHT) | (np.abs(up) > np.sqrt(1 - STRAIGHT**2))
        if mesh.area_faces[straight].sum() < ALL_STRAIGHT * mesh.area:
            continue
        levels, figures = _layers(1000 * mesh.vertices @ to_z.T, mesh.faces, np.abs(up) > 0.5)
        for slack in SLACK:
            pieces = _stacked(levels, figures, slack, most)
            if pieces:
                return [1e-3 * piece @ to_z for piece in pieces]
    return []


def _layers(vertices: Array, faces: np.ndarray, flat: np.ndarray) -> tuple[Array, list[m3.CrossSection]]:
    """Heights (n + 1,) [mm] between layers, and their n figures without narrow holes."""
    heights = np.sort(vertices[faces[flat], 2].mean(axis=1))
    levels = heights[np.concatenate([[True], np.diff(heights) > LEVEL])]
    body = m3.Manifold(m3.Mesh64(np.array(vertices, np.float64), np.array(faces, np.uint64)))
    if body.status() != m3.Error.NoError:
        return levels, []
    return levels, [_filled(body.slice(float(z))) for z in (levels[1:] + levels[:-1]) / 2]


def _filled(figure: m3.CrossSection) -> m3.CrossSection:
    kept = [p for p in figure.simplify(FINE).to_polygons() if _turns_left(p) or np.ptp(p, axis=0).max() > BORE]
    return m3.CrossSection(kept, m3.FillRule.Positive)


def _turns_left(polygon: Array) -> bool:
    x, y = np.asarray(polygon).T
    return bool(x @ np.roll(y, -1) > y @ np.roll(x, -1))


def _stacked(levels: Array, figures: list[m3.CrossSection], slack: float, most: int) -> list[Array]:
    """Corners (n, 3) [mm] of pieces; empty where there are too many."""
    wide = [figure.offset(slack, m3.JoinType.Miter) for figure in figures]
    pieces: list[tuple[m3.CrossSection, int, int]] = []
    for k, figure in enumerate(figures):
        for polygon in _cover(figure, wide[k], most - len(pieces)):
            low, high = k, k + 1  # extended up and down as far as the figures there contain it
            while low > 0 and (polygon - wide[low - 1]).area() < EMPTY:
                low -= 1
            while high < len(figures) and (polygon - wide[high]).area() < EMPTY:
                high += 1
            pieces.append((polygon, low, high))
        if len(pieces) >= most:
            return []
    alone = [p for i, p in enumerate(pieces) if not any(_within(p, o) and (j < i or not _within(o, p))
                                                        for j, o in enumerate(pieces) if j != i)]  # fmt: skip
    return [
        np.array([[x, y, z] for z in (levels[low], levels[high]) for x, y in polygon.simplify(slack).to_polygons()[0]])
        for polygon, low, high in alone
    ]


def _within(a: tuple[m3.CrossSection, int, int], b: tuple[m3.CrossSection, int, int]) -> bool:
    return b[1] <= a[1] and a[2] <= b[2] and (a[0] - b[0]).area() < EMPTY


def _cover(figure: m3.CrossSection, wide: m3.CrossSection, most: int) -> Iterator[m3.CrossSection]:
    """At most `most` convex polygons inside `wide` that cover a figure."""
    polygons = [np.asarray(p) for p in figure.to_polygons()]
    corners = np.concatenate(polygons)
    triangles = corners[np.asarray(m3.triangulate([p.tolist() for p in polygons]))]
    if len(triangles) > MOST:
        return
    left = np.ones(len(triangles), dtype=bool)
    grown = [_grow(i, triangles, wide) for i in range(len(triangles))]
    areas = np.abs(np.linalg.det(triangles[:, 1:] - triangles[:, :1]))
    for _ in range(most):
        gains = [float(areas[held & left].sum()) for _, held in grown]
        best = int(np.argmax(gains))
        yield grown[best][0]
        left &= ~grown[best][1]
        if not left.any():
            return


def _grow(start: int, triangles: Array, wide: m3.CrossSection) -> tuple[m3.CrossSection, np.ndarray]:
    """The hull of a triangle and its nearest others that stays inside, and which triangles it contains (n,) bool."""
    hull = triangles[start]
    middles = triangles.mean(axis=1)
    held = np.zeros(len(triangles), dtype=bool)
    for i in np.argsort(np.linalg.norm(middles - middles[start], axis=1), kind="stable"):
        wider = m3.CrossSection.hull_points(np.concatenate([hull, triangles[i]]).tolist())
        if (wider - wide).area() < EMPTY:
            hull, held[i] = np.asarray(wider.to_polygons()[0]), True
    return m3.CrossSection.hull_points(hull.tolist()), held
