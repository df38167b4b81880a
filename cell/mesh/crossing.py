"""Whether a closed surface passes through itself: rays enter what they are in, or leave what they are not in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from pickproof.cell.frames import Array
from pickproof.cell.mesh.error import MeshError, near

RAYS = 400
CROSSED = 0.02
"""Share of rays through a surface at which it passes through itself."""
VALID = "a surface that bounds one solid; join its solids in the CAD and export again"


@dataclass(frozen=True)
class Crossing:
    """What rays saw: shares of them that were twice inside, or that left what they had not entered; and where."""

    doubled: float
    inverted: float
    where: str

    @property
    def crosses(self) -> bool:
        """More rays saw it than miss hits near edges."""
        return max(self.doubled, self.inverted) > CROSSED

    def error(self) -> MeshError:
        """The refusal."""
        share = 100 * max(self.doubled, self.inverted)
        return MeshError(f"a surface that passes through itself {self.where} (seen by {share:.0f} % of rays)", VALID)


def look_for_crossing(vertices: Array, faces: np.ndarray) -> Crossing:
    """Cast rays through a closed mesh (n, 3) [m], (m, 3) with consistent faces."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    low, high = mesh.bounds
    rng = np.random.default_rng(3)
    along = rng.normal(size=(RAYS, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    start = rng.uniform(low, high, (RAYS, 3)) - along * np.linalg.norm(high - low)
    hits, ray, face = mesh.ray.intersects_location(start, along, multiple_hits=True)
    far = np.einsum("ij,ij->i", hits - start[ray], along[ray])
    order = np.lexsort((far, ray))
    enters = -np.sign(np.einsum("ij,ij->i", mesh.face_normals[face], along[ray]))[order]
    hits, ray = hits[order], ray[order]
    depth = np.cumsum(enters) - np.concatenate([[0.0], np.cumsum(np.bincount(ray, enters, RAYS))])[ray]
    # a closed surface is left as often as it is entered; where not, the ray caster missed a hit near an edge
    told = (np.bincount(ray, enters, RAYS) == 0)[ray]
    seen = max(len(np.unique(ray[told])), 1)
    doubled, inverted = told & (depth > 1.5), told & (depth < -0.5)
    bad = doubled | inverted
    return Crossing(
        doubled=len(np.unique(ray[doubled])) / seen,
        inverted=len(np.unique(ray[inverted])) / seen,
        where=near(hits[bad][:1]) if bad.any() else "",
    )


def check_crossing(vertices: Array, faces: np.ndarray) -> None:
    """Refuse a surface that passes through itself.

    Raises:
        MeshError: so it is.
    """
    crossing = look_for_crossing(vertices, faces)
    if crossing.crosses:
        raise crossing.error()
