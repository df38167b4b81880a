"""Overlap of estimated workpieces: one that lies under another lifts that one with it, or jams."""

from __future__ import annotations

import numpy as np

from pickproof.cell.frames import Array, apply, invert
from pickproof.cell.workpiece.workpiece import Workpiece

SPACING = 0.004  # [m] mean distance of surface points
EDGE = 0.001  # [m] by which another one must extend past a point on all sides; larger than pose errors
LIES = 0.3
"""Score from which an estimate counts as lying on others; low, because sparing a workpiece wrongly costs little."""
ABOVE = 0.0005  # [m] height over a point from which another surface counts as above it


def overlaps(workpiece: Workpiece, Ts_world_part: Array, among: np.ndarray) -> Array:
    """Area (k,) [m2], seen from above, that lies under other workpieces and would collide when lifted straight up.

    An upward surface point counts if it and four points at distance EDGE have another workpiece's CAD above them, at
    any height. Workpieces that touch side by side do not overlap.

    Args:
        Ts_world_part: (k, 4, 4) poses.
        among: (k,) bool: estimates that count as lying on others.
    """
    count = int(np.ceil(workpiece.mesh.area / SPACING**2))
    points, normals = workpiece.sample_surface(count, seed=4)
    share = workpiece.mesh.area / count
    beside = EDGE * np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    radius = float(np.linalg.norm(workpiece.mesh.vertices, axis=1).max())
    found = np.zeros(len(Ts_world_part))
    for k, T in enumerate(Ts_world_part):
        up = normals @ T[2, :3]
        mine = up > 0.1
        starts, weights = apply(T, points[mine]) + np.array([0.0, 0.0, ABOVE]), share * up[mine]
        under = np.zeros(len(starts), dtype=bool)
        for j in np.flatnonzero(among):
            if j == k or np.linalg.norm(Ts_world_part[j, :2, 3] - T[:2, 3]) > 2 * radius:
                continue
            T_other_world = invert(Ts_world_part[j])
            corners = apply(Ts_world_part[j], workpiece.mesh.bounding_box.vertices)
            low, high = corners.min(axis=0), corners.max(axis=0)
            near = np.flatnonzero(
                ~under & (starts[:, :2] > low[:2]).all(axis=1) & (starts[:, :2] < high[:2]).all(axis=1)
                & (starts[:, 2] < high[2])
            )  # fmt: skip
            if not len(near):
                continue
            origins = apply(T_other_world, (starts[near, None] + beside).reshape(-1, 3))
            ways = np.tile(T_other_world[:3, 2], (len(origins), 1))
            hit = workpiece.caster.cast(origins, ways).face >= 0
            under[near[hit.reshape(-1, len(beside)).all(axis=1)]] = True
        found[k] = weights[under].sum()
    return found
