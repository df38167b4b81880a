"""The folder `models` of a BOP dataset: a workpiece as obj_000001.ply in mm, its box, diameter and symmetries."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.data.bop_format import MM, MODELS_INFO, write_json

OBJECT = 1
"""ID of the one object of a dataset that we write."""


def write_models(workpiece: Workpiece, folder: Path) -> None:
    """Write obj_000001.ply (ASCII, with normals) and models_info.json."""
    folder.mkdir(parents=True, exist_ok=True)
    mesh = workpiece.mesh.copy()
    mesh.apply_scale(MM)
    (folder / f"obj_{OBJECT:06d}.ply").write_bytes(
        trimesh.exchange.ply.export_ply(mesh, encoding="ascii", vertex_normal=True)
    )
    write_json(folder / MODELS_INFO, {str(OBJECT): model_info(workpiece)})


def model_info(workpiece: Workpiece) -> dict[str, Any]:
    """Entry of models_info.json; the diameter is the largest distance between two vertices."""
    low, size = MM * workpiece.vertices.min(0), MM * workpiece.extents
    corners = workpiece.vertices[ConvexHull(workpiece.vertices).vertices]
    info: dict[str, Any] = {"diameter": MM * float(pdist(corners).max())}
    info |= {f"min_{axis}": float(x) for axis, x in zip("xyz", low, strict=True)}
    info |= {f"size_{axis}": float(x) for axis, x in zip("xyz", size, strict=True)}
    return info | symmetry_fields(workpiece.symmetry)


def symmetry_fields(symmetry: Symmetry) -> dict[str, Any]:
    """Fields of a symmetry: 4 x 4 matrices row by row without the identity, and axes of continuous rotation.

    All are about the origin, the centre of the bounding box. A sphere has no entry of its own in the format; its three
    axes are given.
    """
    fields: dict[str, Any] = {}
    if len(symmetry.S) > 1:
        turns = np.tile(np.eye(4), (len(symmetry.S) - 1, 1, 1))
        turns[:, :3, :3] = symmetry.S[1:]
        fields["symmetries_discrete"] = [(np.rint(T * 1e12) / 1e12 + 0.0).ravel().tolist() for T in turns]
    axes = range(3) if symmetry.is_sphere else [symmetry.infinite_axis]
    continuous = [{"axis": np.eye(3)[i].tolist(), "offset": [0.0, 0.0, 0.0]} for i in axes if i is not None]
    if continuous:
        fields["symmetries_continuous"] = continuous
    return fields
