"""Workpieces of plain shape for experiments: made in memory, so that their mass and faces are known exactly."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import trimesh

from pickproof.cell.frames import from_rpy, make_transform
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.collision_pieces import CollisionBox, CollisionCylinder, Piece
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece


@lru_cache(maxsize=1)
def _bracket() -> Workpiece:
    return load_workpiece("bracket")


def solid(mesh: trimesh.Trimesh, mass: float, friction: float, pieces: tuple[Piece, ...]) -> Workpiece:
    """A workpiece of steel whose density is such that it has `mass` [kg]."""
    mesh.density = mass / mesh.volume
    return replace(
        _bracket(),
        name="solid",
        vertices=np.array(mesh.vertices),
        faces=np.array(mesh.faces, dtype=np.int64),
        mass=mass,
        com=np.array(mesh.center_mass),
        inertia=np.array(mesh.moment_inertia),
        friction=friction,
        symmetry=Symmetry((0, 0, 0)),
        collision_boxes=tuple(p for p in pieces if isinstance(p, CollisionBox)),
        collision_cylinders=tuple(p for p in pieces if isinstance(p, CollisionCylinder)),
        collision_hulls=(),
        magnetic=True,
    )


def block(size: tuple[float, float, float], mass: float, friction: float = 0.5) -> Workpiece:
    """A box."""
    return solid(trimesh.creation.box(extents=size), mass, friction, (CollisionBox(size=size, centre=(0, 0, 0)),))


def rod(radius: float, length: float, mass: float, friction: float = 0.5) -> Workpiece:
    """A cylinder along its x axis."""
    mesh = trimesh.creation.cylinder(radius=radius, height=length, sections=256)
    mesh.apply_transform(from_rpy(rpy=(0.0, np.pi / 2, 0.0)))
    piece = CollisionCylinder(radius=radius, length=length, centre=(0, 0, 0), rpy=(0, np.pi / 2, 0))
    return solid(mesh, mass, friction, (piece,))


def drilled(size: tuple[float, float, float], mass: float, hole: float, pitch: float) -> Workpiece:
    """A plate with round holes of diameter `hole` at every `pitch` [m], as perforated sheet; collides as a full box."""
    import manifold3d as m3

    body = m3.Manifold.cube(size, True)
    across = [np.arange(-(s // 2 // pitch), s // 2 // pitch + 1) * pitch for s in size[:2]]
    for x in across[0]:
        for y in across[1]:
            body -= m3.Manifold.cylinder(2 * size[2], hole / 2, hole / 2, 24, True).translate((x, y, 0))
    out = body.to_mesh()
    mesh = trimesh.Trimesh(np.asarray(out.vert_properties)[:, :3], np.asarray(out.tri_verts))
    return solid(mesh, mass, 0.5, (CollisionBox(size=size, centre=(0, 0, 0)),))


def ribbed(size: tuple[float, float, float], mass: float, rib: float, height: float) -> Workpiece:
    """A plate with a rib of width `rib` and `height` along y on the middle of its top."""
    plate = CollisionBox(size=size, centre=(0, 0, -height / 2))
    top = CollisionBox(size=(rib, size[1], height), centre=(0, 0, size[2] / 2))
    low = trimesh.creation.box(extents=plate.size, transform=make_transform(t=plate.centre))
    high = trimesh.creation.box(extents=top.size, transform=make_transform(t=top.centre))
    mesh = trimesh.util.concatenate([low, high]) if height == 0 else trimesh.boolean.union([low, high])
    return solid(mesh, mass, 0.5, (plate, top))


def turned(workpiece: Workpiece) -> Workpiece:
    """The same workpiece of boxes, its x axis along y."""
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    boxes = []
    for box in workpiece.collision_boxes:
        (length, width, height), (x, y, z) = box.size, box.centre
        boxes.append(CollisionBox(size=(width, length, height), centre=(-y, x, z)))
    return replace(
        workpiece,
        vertices=workpiece.vertices @ R.T,
        inertia=R @ workpiece.inertia @ R.T,
        com=R @ workpiece.com,
        collision_boxes=tuple(boxes),
    )
