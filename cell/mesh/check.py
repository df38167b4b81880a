"""A triangle mesh from anywhere made a closed surface with outward normals, or refused; what was done is said in words.

Lengths in [m]. Repairs keep the shape: what would have to be guessed is refused.
"""

from __future__ import annotations

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.mesh.bodies import one_body, split_touching
from pickproof.cell.mesh.checked import Checked
from pickproof.cell.mesh.clean import drop_not_numbers, extent, weld, weld_gaps
from pickproof.cell.mesh.coarsen import coarsen
from pickproof.cell.mesh.crossing import look_for_crossing
from pickproof.cell.mesh.edges import is_used, open_edges
from pickproof.cell.mesh.error import MeshError, TornError
from pickproof.cell.mesh.holes import fill
from pickproof.cell.mesh.loose import drop_loose
from pickproof.cell.mesh.remesh import remesh
from pickproof.cell.mesh.winding import wind

PART = (0.003, 2.0)
"""[m] longest side of parts that lie in bins."""
UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "um": 1e-6}
"""[m] of the units in which CAD is exported, likeliest first."""
RARE = 2.3
"""A unit that few use is named where the others are off by this in the logarithm of length."""
WELD = 1e-6
"""Vertices within this share of the longest side are one."""
GAP = 1e-4
"""Open edges are welded where their vertices lie within this share of the longest side."""


def check_mesh(vertices: Array, faces: np.ndarray, unit: str, body: int | None = None) -> Checked:
    """Repair a mesh (n, 3) in `unit`, (m, 3).

    Args:
        body: which of several bodies that do not touch is meant, 1 for the largest.

    Raises:
        MeshError: it is empty, of a size that no part in a bin has, of several bodies, or bounds no solid.
    """
    if len(faces) == 0 or len(vertices) == 0:
        raise MeshError("no faces", "a mesh with faces")
    mesh = Checked(np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64))
    drop_not_numbers(mesh)
    size = extent(mesh.vertices[is_used(mesh.vertices, mesh.faces)])
    if body is None:  # the size of an assembly says nothing of that of its parts
        check_size(size, unit)
    mesh.vertices = mesh.vertices * UNITS[unit]
    weld(mesh, WELD * size * UNITS[unit])
    if len(mesh.faces) == 0:
        raise MeshError("only faces without area", "a mesh with faces")
    torn = Checked(mesh.vertices, mesh.faces.copy(), list(mesh.notes))
    try:
        _close(mesh, size * UNITS[unit])
        one_body(mesh, body)
        crossing = look_for_crossing(mesh.vertices, mesh.faces)
        if crossing.crosses:
            raise TornError(*crossing.error().args) if not crossing.inverted else crossing.error()
    except TornError as reason:
        mesh = _made_anew(torn, reason, body)
    check_size(extent(mesh.vertices) / UNITS[unit], unit)
    coarsen(mesh)
    return mesh


def _close(mesh: Checked, size: float) -> None:
    """Agreeing faces and no holes.

    Raises:
        MeshError: a large hole; TornError: what is left bounds no solid.
    """
    if open_edges(mesh.faces):
        weld_gaps(mesh, GAP * size)
        drop_loose(mesh)
    wind(mesh)
    if open_edges(mesh.faces):
        fill(mesh)
        wind(mesh)
    split_touching(mesh)


def _made_anew(mesh: Checked, reason: MeshError, body: int | None) -> Checked:
    """The surface of the distance field.

    Raises:
        MeshError: the reason why it is needed, where that does not work either.
    """
    mesh.notes.append(f"found {reason.found}")
    try:
        wind(mesh)
        remesh(mesh)
        one_body(mesh, body)
    except TornError:
        raise reason from None
    except MeshError as error:
        raise MeshError(f"{reason.found}; made anew from its distance field: {error.found}", reason.valid) from None
    return mesh


def check_size(longest: float, unit: str) -> None:
    """Question a longest side in `unit` that no part in a bin has.

    Raises:
        MeshError: it names the unit that is meant in all likelihood.
    """
    if not np.isfinite(longest) or longest <= 0:
        raise MeshError(f"a longest side of {longest:g}", "a mesh with an extent")
    low, high = PART
    if low <= longest * UNITS[unit] <= high:
        return

    def off(name: str) -> float:
        length = longest * UNITS[name]
        return max(np.log(low / length), np.log(length / high), 0.0) + (RARE if name == "um" else 0.0)

    valid, likely = f"a part of {1000 * low:g} mm to {high:g} m", min(UNITS, key=off)
    if likely != unit:
        valid += f"; as --unit {likely} it would be {_length(longest * UNITS[likely])} long"
    raise MeshError(f"{_length(longest * UNITS[unit])} long (--unit {unit})", valid)


def _length(metres: float) -> str:
    return f"{metres:.4g} m" if metres >= 2 else f"{1000 * metres:.4g} mm"
