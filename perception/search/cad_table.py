"""What the search needs of the CAD: samples that may lie at a seed, and from which views each of them is seen.

Everything is in normalised CAD coordinates: 1 is `workpiece.unit`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.geometry.raycast import make_caster
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.cad.shape_model import OFF_SURFACE, ShapeModel
from pickproof.perception.search.config import Density, SearchConfig

MOST_SAMPLES = 400
NORMAL_LENGTH = 0.15
"""Length in units that a whole turn of the normal counts as: the two sides of a thin wall are two places."""
STEEPEST = 0.1
"""Least cosine between the normal of a sample and the direction to the camera."""
OCTAHEDRON = 64
"""Cells along an edge of the map from directions to views."""
INFINITE_STEPS = 36


@dataclass(frozen=True)
class CadTable:
    """CAD samples and their visibility; read-only.

    Attributes:
        samples: (m, 3) float32 points of the surface, one of each set that symmetry makes alike.
        frames: (m, 3, 3) float32 right-handed frames; the third column is the outward normal.
        seen: (w, m) bool, whether a sample is seen from a view of `ShapeModel.views`.
        view_at: (OCTAHEDRON, OCTAHEDRON) int16, view nearest to each direction, see `octahedral_map`.
        turns: (k, 2) float32 cosine and sine of the turns about the normal.
    """

    samples: np.ndarray
    frames: np.ndarray
    seen: np.ndarray
    view_at: np.ndarray
    turns: np.ndarray

    @staticmethod
    def of(workpiece: Workpiece, config: SearchConfig) -> CadTable:
        """The table of a workpiece (some tenths of a second)."""
        shape = ShapeModel.of(workpiece)
        density = Density.of(workpiece, config)
        index = spread_samples(shape.points, shape.normals, shape.symmetry, density.spacing)
        points, normals = shape.points[index], shape.normals[index]
        views = shape.views.numpy().astype(np.float64)
        seen = _seen(workpiece, points, normals, views)
        kept = seen.any(0)
        angles = 2 * np.pi / density.turns * np.arange(density.turns)
        arrays = (
            points[kept].astype(np.float32),
            frames_of(normals[kept]),
            np.ascontiguousarray(seen[:, kept]),
            octahedral_map(views),
            np.stack([np.cos(angles), np.sin(angles)], 1).astype(np.float32),
        )
        for array in arrays:
            array.flags.writeable = False
        return CadTable(*arrays)


def spread_samples(points: Array, normals: Array, symmetry: Symmetry, spacing: float) -> np.ndarray:
    """Indices of farthest points (n, 3) at least `spacing` apart, places that symmetry maps to each other being one."""
    places = np.concatenate([points, NORMAL_LENGTH / 2 * normals], axis=1)
    rotations = symmetry.rotations(INFINITE_STEPS)
    distance = np.full(len(points), np.inf)
    chosen: list[int] = []
    i = 0
    while len(chosen) < MOST_SAMPLES:
        chosen.append(i)
        p, n = rotations @ points[i], rotations @ normals[i]
        for alike in np.concatenate([p, NORMAL_LENGTH / 2 * n], axis=1):
            distance = np.minimum(distance, ((places - alike) ** 2).sum(1))
        i = int(distance.argmax())
        if distance[i] < spacing**2:
            break
    return np.array(chosen)


def frames_of(normals: Array) -> np.ndarray:
    """Right-handed frames (n, 3, 3) float32 whose third column is the normal (n, 3)."""
    helper = np.where(np.abs(normals[:, :1]) < 0.9, np.eye(3)[0], np.eye(3)[1])
    x = np.cross(normals, helper)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.ascontiguousarray(np.stack([x, np.cross(normals, x), normals], 2).astype(np.float32))


def octahedral_map(views: Array, size: int = OCTAHEDRON) -> np.ndarray:
    """(size, size) int16: index of the view (w, 3) nearest to the direction of each cell.

    A direction d is scaled to |x| + |y| + |z| = 1; its cell is that of (x, y), the lower half folded outward
    (octahedral map, Meyer et al. 2010).
    """
    axis = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(axis, axis, indexing="ij")
    z = 1 - np.abs(x) - np.abs(y)
    folded_x = np.where(z < 0, (1 - np.abs(y)) * np.where(x >= 0, 1, -1), x)
    folded_y = np.where(z < 0, (1 - np.abs(x)) * np.where(y >= 0, 1, -1), y)
    directions = np.stack([folded_x, folded_y, z], -1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return (directions.reshape(-1, 3) @ views.T).argmax(1).reshape(size, size).astype(np.int16)


def _seen(workpiece: Workpiece, points: Array, normals: Array, views: Array) -> np.ndarray:
    caster = make_caster(workpiece.vertices / workpiece.unit, workpiece.faces)
    seen = np.zeros((len(views), len(points)), dtype=np.bool_)
    for v, view in enumerate(views):
        facing = np.flatnonzero(normals @ view > STEEPEST)
        if len(facing):
            origins = points[facing] + OFF_SURFACE * normals[facing]
            hits = caster.cast(origins, np.tile(view, (len(facing), 1)))
            seen[v, facing[~np.isfinite(hits.t)]] = True
    return seen
