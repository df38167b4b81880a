"""Rays from the faces of a gripper to the exact CAD of the workpieces under it, holes included."""

from __future__ import annotations

import numpy as np

from pickproof.cell.frames import Array, apply, invert
from pickproof.cell.grippers.one_sided import Surface
from pickproof.cell.physics.world import World
from pickproof.cell.workpiece.workpiece import Workpiece

START = 0.004  # [m] start of the rays behind the plane of the faces, whose shapes may penetrate the CAD slightly
REACH = 0.05  # [m] end of the rays in front of that plane


def probe(world: World, T_world_tool: Array, points_tool: Array) -> Surface:
    """Hits of rays along tool z from points (n, 2) [m] of the tool's xy plane."""
    n = len(points_tool)
    gap, cosine, part = np.full(n, np.inf), np.zeros(n), np.full(n, -1)
    far = float(np.linalg.norm(points_tool, axis=1).max(initial=0.0)) + REACH
    for i, workpiece in enumerate(world.workpieces):
        T_part_tool = invert(world.part_pose(i)) @ T_world_tool
        if np.linalg.norm(T_part_tool[:3, 3]) > far + np.linalg.norm(workpiece.extents) / 2:
            continue
        one = probe_part(workpiece, T_part_tool, points_tool)
        nearer = one.gap < gap
        gap[nearer], cosine[nearer], part[nearer] = one.gap[nearer], one.cosine[nearer], i
    return Surface(gap, cosine, part)


def probe_part(workpiece: Workpiece, T_part_tool: Array, points_tool: Array) -> Surface:
    """Hits of the same rays on one workpiece alone, as part 0."""
    n, way = len(points_tool), T_part_tool[:3, 2]
    origins = apply(T_part_tool, np.column_stack([points_tool, np.full(n, -START)]))
    hits = workpiece.caster.cast(origins, np.tile(way, (n, 1)))
    hit = (hits.face >= 0) & (hits.t < START + REACH)
    cosine = np.where(hit, -(workpiece.mesh.face_normals[hits.face] @ way), 0.0)
    return Surface(np.where(hit, hits.t - START, np.inf), cosine, np.where(hit, 0, -1))
