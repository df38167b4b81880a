"""A workpiece folder written on the fly: a box whose CAD frame, centre of mass and inertia axes can be chosen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
import yaml

BLOCK = {
    "name": "block",
    "mesh": "block.stl",
    "mesh_unit": "m",
    "material": "steel",
    "density": 7850,
    "friction": 0.5,
    "collision_boxes": [{"size": [0.04, 0.03, 0.02], "centre": [0, 0, 0]}],
    "heap": {"bin_inner": [0.3, 0.2, 0.1]},
}


def write_block(folder: Path, mesh: trimesh.Trimesh | None = None, **changes: object) -> Path:
    """Write `folder`/block with its YAML; a change to None drops the field. Returns the path of the YAML."""
    target = folder / "block"
    target.mkdir(parents=True, exist_ok=True)
    (mesh or trimesh.creation.box(extents=(0.04, 0.03, 0.02))).export(target / "block.stl")
    config = {k: v for k, v in {**BLOCK, **changes}.items() if v is not None}
    (target / "workpiece.yaml").write_text(yaml.safe_dump(config))
    return target / "workpiece.yaml"


def skew_mesh() -> trimesh.Trimesh:
    """A watertight tetrahedron, its bounding box centred: the centre of mass is off, the inertia axes are turned."""
    vertices = np.array([[-0.02, -0.015, -0.01], [0.02, -0.01, -0.01], [0.0, 0.015, -0.01], [-0.01, -0.01, 0.01]])
    return trimesh.convex.convex_hull(vertices)
