"""First hits of rays with a triangle mesh by Embree: through Open3D where it can be imported, else through embreex.

Training therefore runs without Open3D. Embree finds the triangle that is hit; the distance is that of
`cell/geometry/ray_hits.py`, the same on every processor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pickproof.cell.frames import Array


@dataclass(frozen=True)
class Hits:
    """First hits of n rays.

    Attributes:
        t: (n,) float64 in lengths of the ray's direction, infinite where nothing is hit.
        face: (n,) int64 index of the triangle, -1 where nothing is hit.
    """

    t: Array
    face: np.ndarray


class RayCaster(Protocol):
    """Casts rays against one mesh."""

    def cast(self, origins: Array, directions: Array) -> Hits:
        """First hits of rays from `origins` (n, 3) or (3,) [m] along `directions` (n, 3) of any length."""
        ...


class _Caster:
    """Hits of the triangles that Embree found."""

    def __init__(self, vertices: Array, faces: np.ndarray) -> None:
        self._vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        self._faces = np.ascontiguousarray(faces, dtype=np.int64)

    def cast(self, origins: Array, directions: Array) -> Hits:
        from pickproof.cell.geometry.ray_hits import as_rays, exact_hits  # numba takes a second to import

        rays = as_rays(origins, directions)
        return Hits(*exact_hits(self._vertices, self._faces, *rays, self._found(*rays)))

    def _found(self, origins: Array, directions: Array) -> np.ndarray:
        raise AssertionError("each caster has its own")


class Open3dCaster(_Caster):
    """Embree through Open3D, which can use several threads."""

    def __init__(self, vertices: Array, faces: np.ndarray, threads: int = 1) -> None:
        super().__init__(vertices, faces)
        from pickproof.cell.geometry._open3d import load_open3d

        self._o3d = load_open3d()
        self._threads = threads
        self._scene = self._o3d.t.geometry.RaycastingScene(nthreads=threads)
        self._scene.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))

    def _found(self, origins: Array, directions: Array) -> np.ndarray:
        rays = np.empty((len(directions), 6), dtype=np.float32)
        rays[:, :3], rays[:, 3:] = origins, directions
        hit = self._scene.cast_rays(self._o3d.core.Tensor(rays), nthreads=self._threads)
        return np.where(np.isfinite(hit["t_hit"].numpy()), hit["primitive_ids"].numpy().astype(np.int64), -1)


class EmbreexCaster(_Caster):
    """Embree through embreex, on one thread."""

    def __init__(self, vertices: Array, faces: np.ndarray) -> None:
        super().__init__(vertices, faces)
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, vertices.astype(np.float32), faces.astype(np.int32))

    def _found(self, origins: Array, directions: Array) -> np.ndarray:
        directions = np.ascontiguousarray(directions, dtype=np.float32)
        origins = np.ascontiguousarray(np.broadcast_to(origins, directions.shape), dtype=np.float32)
        return np.asarray(self._scene.run(origins, directions, output=True)["primID"].astype(np.int64))


def make_caster(vertices: Array, faces: np.ndarray, threads: int = 1) -> RayCaster:
    """A ray caster for the mesh (n, 3) [m], (m, 3); `threads` counts with Open3D alone."""
    try:
        return Open3dCaster(vertices, faces, threads)
    except ImportError:
        return EmbreexCaster(vertices, faces)
