"""Parametric CAD in [mm]: solids that carry the collision pieces that stand for them.

Adding solids joins bodies and pieces; taking one away cuts the body alone, so pieces leave bores and slots out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import manifold3d as m3
import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from pickproof.cell.frames import Array, from_rpy, make_transform
from pickproof.cell.workpiece.collision_pieces import CollisionBox, CollisionCylinder

Piece = CollisionBox | CollisionCylinder
"""Here in [mm], so made by `model_construct`: the bounds of these models are for [m]."""

AXES = {"z": (0.0, 0.0, 0.0), "x": (0.0, np.pi / 2, 0.0), "y": (-np.pi / 2, 0.0, 0.0)}
"""Roll, pitch, yaw that turn z into the axis of that name."""


@dataclass(frozen=True)
class Solid:
    """A body and its collision pieces, both in [mm]."""

    body: m3.Manifold
    pieces: tuple[Piece, ...] = ()

    def __add__(self, other: Solid) -> Solid:
        return Solid(self.body + other.body, self.pieces + other.pieces)

    def __sub__(self, other: Solid) -> Solid:
        return Solid(self.body - other.body, self.pieces)

    def moved(self, T: Array) -> Solid:
        """The same, mapped by a transform (4, 4) in [mm]."""
        return Solid(self.body.transform(T[:3]), tuple(_moved(piece, T) for piece in self.pieces))

    def turned_about_z(self, angle_deg: float) -> Solid:
        """The same, turned about the z axis."""
        return self.moved(from_rpy(rpy=(0.0, 0.0, np.deg2rad(angle_deg))))

    def bare(self) -> Solid:
        """Without its pieces."""
        return Solid(self.body)

    def centred(self) -> Solid:
        """With the centre of the body's bounding box at the origin."""
        low, high = np.split(np.asarray(self.body.bounding_box()), 2)
        return self.moved(make_transform(t=-(low + high) / 2))

    def mesh(self) -> trimesh.Trimesh:
        """The surface as a mesh."""
        mesh = self.body.to_mesh64()
        return trimesh.Trimesh(np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts))


def box(low: ArrayLike, high: ArrayLike) -> Solid:
    """A box between two corners."""
    size, centre = np.subtract(high, low), np.add(low, high) / 2
    body = m3.Manifold.cube(size.tolist()).translate(np.asarray(low).tolist())
    return Solid(body, (CollisionBox.model_construct(size=tuple(size.tolist()), centre=tuple(centre.tolist())),))


def cylinder(radius: float, start: ArrayLike, length: float, axis: str = "z", segments: int = 40) -> Solid:
    """A cylinder from the centre of one end along `axis`; a corner of its polygon lies on each of the other axes."""
    body = m3.Manifold.cylinder(length, radius, radius, segments).translate((0, 0, -length / 2))
    piece = CollisionCylinder.model_construct(radius=radius, length=length, centre=(0.0, 0.0, 0.0))
    T = from_rpy(rpy=AXES[axis])
    T[:3, 3] = np.asarray(start, dtype=np.float64) + T[:3, 2] * length / 2
    return Solid(body, (piece,)).moved(T)


def revolved(profile: Sequence[tuple[float, float]], segments: int = 48) -> Solid:
    """A body of revolution about z from its profile of (radius, z), counter-clockwise; it has no pieces."""
    return Solid(m3.CrossSection([profile]).revolve(segments))


def extruded(outline: ArrayLike, low: float, high: float) -> Solid:
    """A prism along z over an outline of (x, y), counter-clockwise; it has no pieces."""
    return Solid(m3.CrossSection([np.asarray(outline).tolist()]).extrude(high - low).translate((0, 0, low)))


def pieces_yaml(solid: Solid) -> str:
    """The pieces in [m] as workpiece.yaml wants them."""
    boxes = [p for p in solid.pieces if isinstance(p, CollisionBox)]
    cylinders = [p for p in solid.pieces if isinstance(p, CollisionCylinder)]
    lines = []
    if boxes:
        lines.append("collision_boxes: # [m] in the CAD frame, printed by make_cad.py")
        lines += [f"  - {{size: {_metres(p.size)}, centre: {_metres(p.centre)}{_rpy(p.rpy)}}}" for p in boxes]
    if cylinders:
        lines.append("collision_cylinders: # [m] in the CAD frame, printed by make_cad.py")
        for p in cylinders:
            radius, length = _metres([p.radius, p.length]).strip("[]").split(", ")
            lines.append(f"  - {{radius: {radius}, length: {length}, centre: {_metres(p.centre)}{_rpy(p.rpy)}}}")
    return "\n".join(lines)


def write(solid: Solid, path: Path) -> None:
    """Write the mesh and print what workpiece.yaml needs."""
    mesh = solid.mesh()
    assert mesh.is_watertight
    mesh.export(path)
    print(f"extents {mesh.extents.round(3)} mm, volume {mesh.volume:.0f} mm3, {len(mesh.faces)} faces")
    print(pieces_yaml(solid))


def _moved(piece: Piece, T: Array) -> Piece:
    moved = T @ from_rpy(piece.centre, piece.rpy)
    centre, R = tuple(moved[:3, 3].tolist()), moved[:3, :3]
    if isinstance(piece, CollisionCylinder):
        x, y, z = R[:, 2] if R[2, 2] >= 0 else -R[:, 2]  # either end first
        x, y = (0.0 if abs(w) < 1e-12 else float(w) for w in (x, y))
        rpy = (0.0, float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x)))
        return piece.model_copy(update={"centre": centre, "rpy": rpy})
    size, axes = np.asarray(piece.size), np.rint(np.abs(R))
    if np.abs(np.abs(R) - axes).max() < 1e-12:  # by quarter turns: still a box along the axes
        return CollisionBox.model_construct(size=tuple((axes @ size).tolist()), centre=centre)
    rpy = tuple(Rotation.from_matrix(R).as_euler("xyz").tolist())
    return CollisionBox.model_construct(size=piece.size, centre=centre, rpy=rpy)


def _metres(mm: Sequence[float]) -> str:
    return "[" + ", ".join(f"{x / 1000 + 0.0:.6g}" if abs(x) > 1e-9 else "0.0" for x in mm) + "]"


def _rpy(rpy: Sequence[float]) -> str:
    if np.abs(rpy).max() < 1e-9:
        return ""
    return ", rpy: [" + ", ".join(f"{x:.9g}" if abs(x) > 1e-9 else "0.0" for x in rpy) + "]"
