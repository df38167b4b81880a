"""Nearest points of a mesh, by Embree through Open3D, in single precision.

On triangles 1 m long and a few millimetres wide, Embree's error is nearly 1 mm, so long edges are split first.
"""

from __future__ import annotations

import manifold3d as m3
import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.geometry._open3d import load_open3d

CUTS = 20.0
"""Longest edge, as a share of the diagonal of the bounding box."""


class Nearest:
    """Nearest points of one closed mesh with vertices (n, 3) [m] and faces (m, 3)."""

    def __init__(self, vertices: Array, faces: np.ndarray) -> None:
        self._o3d = load_open3d()
        body = m3.Manifold(m3.Mesh64(np.array(vertices, np.float64), np.array(faces, np.uint64)))
        if body.status() == m3.Error.NoError:
            made = body.refine_to_length(float(np.linalg.norm(np.ptp(vertices, axis=0))) / CUTS).to_mesh64()
            vertices, faces = np.asarray(made.vert_properties)[:, :3], np.asarray(made.tri_verts)
        self._scene = self._o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(np.array(vertices, np.float32), np.array(faces, np.uint32))

    def distances(self, points: Array) -> Array:
        """Distances (n,) [m] of points (n, 3) to the surface, in single precision."""
        query = np.ascontiguousarray(points, dtype=np.float32)
        return np.asarray(self._scene.compute_distance(self._o3d.core.Tensor(query), nthreads=1).numpy())

    def offsets(self, points: Array) -> tuple[Array, Array]:
        """From the nearest surface to points (n, 3): vectors (n, 3) [m], and the normals (n, 3) there."""
        query = np.ascontiguousarray(points, dtype=np.float32)
        answer = self._scene.compute_closest_points(self._o3d.core.Tensor(query), nthreads=1)
        return query - answer["points"].numpy(), answer["primitive_normals"].numpy()

    def signed(self, points: Array) -> Array:
        """Distances (n,) [m] of points (n, 3), negative inside a closed mesh."""
        query = np.ascontiguousarray(points, dtype=np.float32)
        distance = self._scene.compute_signed_distance(self._o3d.core.Tensor(query), nthreads=1)
        return np.asarray(distance.numpy(), dtype=np.float64)
