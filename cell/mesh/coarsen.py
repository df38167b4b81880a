"""Fewer faces where a surface has many; rays and contacts cost time for each."""

from __future__ import annotations

import numpy as np

from pickproof.cell.mesh.bodies import arrays, manifold
from pickproof.cell.mesh.checked import Checked
from pickproof.cell.mesh.clean import extent
from pickproof.cell.mesh.error import MeshError

MANY_FACES = 20_000
COARSEST = (2e-4, 2e-3)
"""[m], and share of the longest side, by which a surface of many faces may move at most to lose some of them."""


def coarsen(mesh: Checked) -> None:
    """Leave out faces where the surface moves by little, until few are left.

    Raises:
        MeshError: as many are needed, as for a rough scan.
    """
    n, size = len(mesh.faces), extent(mesh.vertices)
    if n <= MANY_FACES:
        return
    body = manifold(mesh.vertices, mesh.faces)
    coarsest, moved = max(COARSEST[0], COARSEST[1] * size), 0.0
    for step in coarsest * np.array([0.02, 0.08, 0.2, 0.7]):
        body, moved = body.simplify(step), moved + step
        if body.num_tri() <= MANY_FACES:
            break
    mesh.vertices, mesh.faces = arrays(body)
    left = len(mesh.faces)
    if left > 3 * MANY_FACES:
        raise MeshError(
            f"{n} faces, {left} of them needed to stay within {1000 * coarsest:.2g} mm",
            f"a surface smooth enough for {3 * MANY_FACES} faces; a scan wants smoothing first",
        )
    mesh.moved = max(mesh.moved, float(moved))
    mesh.notes.append(f"{n} faces made {left}; the surface moved by {1000 * moved:.2g} mm at most")
