"""Rays from the faces of a gripper to the exact CAD of the workpieces under it, holes included."""

from __future__ import annotations

import numpy as np

from cell.frames import Array, apply, invert
from cell.pads import Surface
from cell.world import World

START = 0.004  # [m] behind the plane of the faces at which rays start: their shapes may stand in the CAD by a hair
REACH = 0.05  # [m] in front of it at which they end


def probe(world: World, T_world_tool: Array, points_tool: Array) -> Surface:
    """What rays along tool z hit from points (n, 2) [m] of the tool's xy plane."""
    n = len(points_tool)
    t, cosine, part = np.full(n, START + REACH), np.zeros(n), np.full(n, -1)
    origins = apply(T_world_tool, np.column_stack([points_tool, np.full(n, -START)]))
    direction = T_world_tool[:3, 2]
    far = float(np.linalg.norm(points_tool, axis=1).max(initial=0.0)) + REACH
    for i, workpiece in enumerate(world.workpieces):
        T_part_world = invert(world.part_pose(i))
        away = np.linalg.norm(apply(T_part_world, T_world_tool[:3, 3][None])[0])
        if away > far + np.linalg.norm(workpiece.extents) / 2:
            continue
        way = T_part_world[:3, :3] @ direction
        hits = workpiece.caster.cast(apply(T_part_world, origins), np.tile(way, (n, 1)))
        nearer = (hits.face >= 0) & (hits.t < t)
        t[nearer], part[nearer] = hits.t[nearer], i
        cosine[nearer] = -(workpiece.mesh.face_normals[hits.face[nearer]] @ way)
    return Surface(np.where(part >= 0, t - START, np.inf), cosine, part)
