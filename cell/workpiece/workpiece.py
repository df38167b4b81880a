"""The workpiece: CAD, mass, symmetry, collision pieces, friction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh
from pydantic import Field

from pickproof.cell.config import Config, Fine, Length, Size, load
from pickproof.cell.errors import InputError, did_you_mean
from pickproof.cell.frames import Array
from pickproof.cell.geometry.raycast import RayCaster, make_caster
from pickproof.cell.mesh.crossing import check_crossing
from pickproof.cell.mesh.edges import is_closed
from pickproof.cell.mesh.error import MeshError
from pickproof.cell.mesh.file import kind_of, read_mesh
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.collision_pieces import (
    CollisionBox,
    CollisionCylinder,
    CollisionHull,
    Piece,
    Triple,
    bounds,
    covering_boxes,
    read_hulls,
)
from pickproof.cell.workpiece.folders import list_workpieces, search_path, workpiece_folder
from pickproof.cell.workpiece.optics import Optics

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
SIZES = (1e-3, 5.0)
"""[m] longest side of a part."""
MESHES = ("stl", "obj", "ply", "glb")
READABLE = "a readable STL, OBJ, PLY or GLB file"
UNIT_GIRTHS = 1.4
Process = Literal["machined", "bent", "printed", "cast"]
FORM_TOLERANCES: dict[Process, float] = {"machined": 0.0, "bent": 2e-4, "printed": 2e-4, "cast": 3e-4}
"""[m] standard deviation of a real surface from its CAD: assumptions, for bent and printed ones from two scans
(docs/measurements/search.md). No camera here can tell the deviation of a machined part."""


class SymmetryConfig(Config):
    """d_x, d_y, d_z of the paper in [deg], 0 for none; `infinite_below` is T_s."""

    degrees: Triple = Field((0.0, 0.0, 0.0), description="[deg] smallest symmetric rotations about x, y, z; 0 for none")
    infinite_below: float = Field(15.0, gt=0, description="[deg] T_s of the paper: a finer symmetry counts as infinite")


class HeapConfig(Config):
    """The heaps on which perception is trained and evaluated, suited to the size of the workpiece."""

    bin_inner: Size = Field(description="[m] length, width, depth")
    count: tuple[int, int] = Field((6, 40), description="fewest and most workpieces in a heap")
    camera_distance: Length = Field(0.85, description="[m] camera to bin floor")


class WorkpieceConfig(Config):
    """Schema of workpiece.yaml."""

    name: str = Field(description="that of the folder")
    paper_row: str = Field("", description="row of the paper with this envelope and symmetry")
    mesh: str = Field(description="STL, OBJ, PLY or GLB file beside this one")
    mesh_unit: Literal["m", "cm", "mm"] = Field(description="of the lengths in the mesh")
    material: str = Field(description="for the reader")
    density: float = Field(gt=10, lt=30000, description="[kg/m3]")
    friction: float = Field(
        gt=0, le=2, description="coefficient of the surface; a contact has the geometric mean of two"
    )
    rolling_friction: Fine = Field(0.0, description="[m] lever of rolling resistance, as of teeth")
    magnetic: bool = Field(False, description="true if a magnet holds it (steel, cast iron)")
    optics: Optics = Field(Optics(), description="how the surface returns light")
    symmetry: SymmetryConfig = Field(SymmetryConfig(), description="symmetry of the workpiece")
    collision_boxes: tuple[CollisionBox, ...] = Field((), description="solid boxes of the physics")
    collision_cylinders: tuple[CollisionCylinder, ...] = Field((), description="solid cylinders of the physics")
    collision_hulls: str | None = Field(None, description="OBJ file in mesh_unit; its objects are convex pieces")
    heap: HeapConfig = Field(description="heaps of training and evaluation")
    tolerance: Fine = Field(0.005, gt=0, description="T_e of the paper in [m]")
    process: Process = Field("machined", description="how the part is made; gives the default of form_tolerance")
    form_tolerance: Fine | None = Field(
        None, description="[m] standard deviation of the real surface from the CAD; none: that of the process"
    )


@dataclass(frozen=True)
class Workpiece:
    """One workpiece; all lengths in [m], in the CAD frame whose origin is the centre of the bounding box.

    With an axis of odd order that centre is not on the axis; then the origin is on the axis.

    Attributes:
        vertices, faces: the exact mesh (n, 3) and (m, 3), read-only.
        mass: in [kg]; com: centre of mass (3,); inertia: (3, 3) about the centre of mass in [kg m2].
        tolerance: T_e, the distance under which an estimate counts as right.
        magnetic: a magnet holds it.
        rolling_friction: [m] lever of the normal force that resists rolling.
        form_tolerance: [m] standard deviation of the real surface from the CAD.
    """

    name: str
    folder: Path
    vertices: Array
    faces: np.ndarray
    mass: float
    com: Array
    inertia: Array
    friction: float
    optics: Optics
    symmetry: Symmetry
    collision_boxes: tuple[CollisionBox, ...]
    collision_cylinders: tuple[CollisionCylinder, ...]
    collision_hulls: tuple[CollisionHull, ...]
    heap: HeapConfig
    tolerance: float
    magnetic: bool = False
    rolling_friction: float = 0.0
    form_tolerance: float = 0.0

    @property
    def extents(self) -> Array:
        """Edge lengths (3,) of the bounding box."""
        return np.ptp(self.vertices, axis=0)

    @cached_property
    def unit(self) -> float:
        """Length in [m] that becomes 1 in the normalised workpiece space.

        The longest side, but at most UNIT_GIRTHS times the mean girth (surface area over longest side): a slender part
        scaled by its length alone would be thinner than the sampling.
        """
        longest = float(self.extents.max())
        return min(longest, UNIT_GIRTHS * float(self.mesh.area) / longest)

    @property
    def units_long(self) -> int:
        """Units along the longest side, rounded up: 1, more for slender parts."""
        return math.ceil(float(self.extents.max()) / self.unit - 1e-6)

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """All collision pieces: boxes, then cylinders, then hulls."""
        return (*self.collision_boxes, *self.collision_cylinders, *self.collision_hulls)

    def piece_boxes(self) -> list[tuple[Triple, Array]]:
        """Boxes that cover every collision piece: full edge lengths [m] and T_part_box (4, 4)."""
        return list(self._piece_boxes)

    @cached_property
    def _piece_boxes(self) -> tuple[tuple[Triple, Array], ...]:
        return tuple(box for piece in self.pieces for box in covering_boxes(piece))

    @cached_property
    def mesh(self) -> trimesh.Trimesh:
        """The CAD mesh in the CAD frame [m]."""
        return trimesh.Trimesh(self.vertices, self.faces, process=False)

    @cached_property
    def caster(self) -> RayCaster:
        """Casts rays against the CAD, in its frame."""
        return make_caster(self.vertices, self.faces)

    def sample_surface(self, n: int, seed: int = 0) -> tuple[Array, Array]:
        """Points and outward normals, each (n, 3), uniform over the surface."""
        points, face = trimesh.sample.sample_surface(self.mesh, n, seed=seed)
        return np.asarray(points), np.asarray(self.mesh.face_normals[face])


def load_workpiece(name: str) -> Workpiece:
    """Load a workpiece by name.

    Raises:
        InputError: no such workpiece, an invalid workpiece.yaml, or a missing or unusable mesh.
    """
    folder = workpiece_folder(name)
    if folder is None:
        known = list_workpieces()
        raise InputError("command line", "workpiece", name, f"one of: {', '.join(known)}{did_you_mean(name, known)}")
    return _load(folder)


def _load(folder: Path) -> Workpiece:
    path = folder / "workpiece.yaml"
    config = load(WorkpieceConfig, path)
    mesh = _read_mesh(path, folder / config.mesh)
    mesh.apply_scale(UNITS[config.mesh_unit])
    _check_size(path, config.mesh_unit, mesh.extents)
    mesh.density = config.density
    vertices, faces = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)
    vertices.flags.writeable = faces.flags.writeable = False
    try:
        symmetry = Symmetry(config.symmetry.degrees, config.symmetry.infinite_below)
    except ValueError:
        raise InputError(path, "symmetry.degrees", config.symmetry.degrees, "a finite rotation group") from None
    _check_origin(path, mesh, symmetry)
    hulls: tuple[CollisionHull, ...] = ()
    if config.collision_hulls is not None:
        hulls = read_hulls(path, folder / config.collision_hulls, UNITS[config.mesh_unit])
    _check_pieces(path, config, hulls, mesh.bounds)
    return Workpiece(
        name=config.name,
        folder=folder,
        vertices=vertices,
        faces=faces,
        mass=float(mesh.mass),
        com=np.array(mesh.center_mass),
        inertia=np.array(mesh.moment_inertia),
        friction=config.friction,
        optics=config.optics,
        symmetry=symmetry,
        collision_boxes=config.collision_boxes,
        collision_cylinders=config.collision_cylinders,
        collision_hulls=hulls,
        heap=config.heap,
        tolerance=config.tolerance,
        magnetic=config.magnetic,
        rolling_friction=config.rolling_friction,
        form_tolerance=FORM_TOLERANCES[config.process] if config.form_tolerance is None else config.form_tolerance,
    )


def _check_size(path: Path, unit: str, extents: Array) -> None:
    """Check the length of the longest side; the error names the unit that was probably meant."""
    longest = float(extents.max())
    if SIZES[0] < longest < SIZES[1]:
        return
    size, valid = " x ".join(f"{e:.4g}" for e in extents), f"a part of {1000 * SIZES[0]:g} mm to {SIZES[1]:g} m"
    for other in ("mm", "cm", "m"):
        meant = longest * UNITS[other] / UNITS[unit]
        if SIZES[0] < meant < SIZES[1]:
            valid += f"; in {other} it would be {1000 * meant:.4g} mm long"
            break
    raise InputError(path, "mesh_unit", f"{unit} (part of {size} m)", valid)


def _check_origin(path: Path, mesh: trimesh.Trimesh, symmetry: Symmetry) -> None:
    """Check that the origin is the centre of the bounding box, or lies on the axis of symmetry."""
    near = 1e-3 * float(mesh.extents.max())
    middle, across = mesh.bounds.mean(axis=0), np.eye(3) - symmetry.fixed
    along = float(np.linalg.norm(symmetry.fixed @ middle))
    off = float(min(np.linalg.norm(across @ middle), np.linalg.norm(across @ np.asarray(mesh.center_mass))))
    if max(along, off) > near:
        found = f"centre of bounding box {np.linalg.norm(middle):.4g} m off the origin"
        raise InputError(path, "mesh", found, "a centred mesh, or one with its axis of symmetry through the origin")


def _check_pieces(path: Path, config: WorkpieceConfig, hulls: tuple[CollisionHull, ...], box: Array) -> None:
    """Check that there is a piece, and none exceeds the CAD's bounding box (2, 3) by a tenth of its longest side."""
    kinds: dict[str, Sequence[Piece]] = {
        "collision_boxes": config.collision_boxes,
        "collision_cylinders": config.collision_cylinders,
        "collision_hulls": hulls,
    }
    if not any(kinds.values()):
        raise InputError(path, "collision_boxes", [], "at least one piece (or collision_cylinders, collision_hulls)")
    slack = 0.1 * np.ptp(box, axis=0).max()
    for kind, pieces in kinds.items():
        for i, piece in enumerate(pieces):
            low, high = bounds(piece)
            if (low < box[0] - slack).any() or (high > box[1] + slack).any():
                reach = " .. ".join(str(np.round(corner, 4).tolist()) for corner in (low, high))
                size = " x ".join(f"{e:.4g}" for e in np.ptp(box, axis=0))
                raise InputError(path, f"{kind}.{i}", reach, f"a piece within the CAD's bounding box of {size} m")


def _read_mesh(yaml_path: Path, path: Path) -> trimesh.Trimesh:
    if not path.is_file():
        raise InputError(yaml_path, "mesh", str(path), "an existing STL, OBJ, PLY or GLB file")
    if kind_of(path) not in MESHES:
        raise InputError(yaml_path, "mesh", str(path), f"{READABLE}; `pickproof onboard` takes STEP")
    try:
        raw = read_mesh(path)
    except MeshError as error:
        raise InputError(yaml_path, "mesh", f"{path.name}: {error.found}", error.valid) from None
    mesh = trimesh.Trimesh(raw.vertices, raw.faces)
    if len(mesh.faces) == 0 or not np.isfinite(raw.vertices).all():
        raise InputError(yaml_path, "mesh", str(path), "a mesh with faces and finite vertices")
    if not is_closed(np.asarray(mesh.faces)) or mesh.volume <= 0:
        raise InputError(yaml_path, "mesh", str(path), "a watertight mesh with outward normals (mass comes from it)")
    if mesh.body_count > 1:  # overlapping solids would count mass twice
        try:
            check_crossing(np.asarray(mesh.vertices), np.asarray(mesh.faces))
        except MeshError as error:
            raise InputError(yaml_path, "mesh", f"{path.name}: {error.found}", error.valid) from None
    return mesh


__all__ = [
    "HeapConfig",
    "SymmetryConfig",
    "Workpiece",
    "WorkpieceConfig",
    "list_workpieces",
    "load_workpiece",
    "search_path",
    "workpiece_folder",
]
