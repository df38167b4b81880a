"""The collision shape of a workpiece in the physics."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from pickproof.cell.frames import Array, apply, to_quat_xyzw
from pickproof.cell.physics._pybullet import pybullet
from pickproof.cell.workpiece.collision_pieces import CollisionBox, CollisionCylinder, CollisionHull, Piece

NOTHING = {"halfExtents": [0.0] * 3, "radii": 0.0, "lengths": 0.0, "fileNames": "", "meshScales": [1.0] * 3}


def collision_shape(client: Any, pieces: Sequence[Piece], T_body_part: Array) -> int:
    """Make one compound shape of all pieces in the frame of a body; returns its id."""
    rows, Ts = [], []
    for piece in pieces:
        if isinstance(piece, CollisionBox):
            rows.append({"shapeTypes": pybullet.GEOM_BOX, "halfExtents": [s / 2 for s in piece.size]})
            Ts.append(T_body_part @ piece.T_part_box)
        elif isinstance(piece, CollisionCylinder):
            rows.append({"shapeTypes": pybullet.GEOM_CYLINDER, "radii": piece.radius, "lengths": piece.length})
            Ts.append(T_body_part @ piece.T_part_cylinder)
    hulls = [apply(T_body_part, piece.without_margin()) for piece in pieces if isinstance(piece, CollisionHull)]
    with tempfile.TemporaryDirectory() as folder:  # as part of a compound, hulls reach the engine through a file only
        if hulls:
            path = Path(folder) / "hulls.obj"
            path.write_text(_obj(hulls))
            rows.append({"shapeTypes": pybullet.GEOM_MESH, "fileNames": str(path)})
            Ts.append(np.eye(4))
        names = {name for row in rows for name in row}
        if hulls:
            names.add("meshScales")
        return int(
            client.createCollisionShapeArray(
                **{name: [row.get(name, NOTHING.get(name)) for row in rows] for name in sorted(names)},
                collisionFramePositions=[T[:3, 3].tolist() for T in Ts],
                collisionFrameOrientations=[to_quat_xyzw(T).tolist() for T in Ts],
            )
        )


def _obj(hulls: Sequence[Array]) -> str:
    lines, first = [], 1
    for i, vertices in enumerate(hulls):
        lines.append(f"o hull{i}")
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
        lines += [f"f {a} {b} {c}" for a, b, c in ConvexHull(vertices).simplices + first]
        first += len(vertices)
    return "\n".join(lines) + "\n"
