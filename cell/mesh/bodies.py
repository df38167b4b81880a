"""The bodies of a closed mesh: hollow ones, overlapping ones, ones inside out; made one, or refused."""

from __future__ import annotations

import manifold3d as m3
import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from pickproof.cell.frames import Array
from pickproof.cell.mesh.error import MeshError

CRUMB = 0.005
"""Bodies below this share of the volume are left out."""
MANY = 500
RAYS = 400
CROSSED = 0.02
"""Share of rays through a surface, which enter what they are in already, at which it passes through itself."""


def one_body(vertices: Array, faces: np.ndarray) -> tuple[Array, np.ndarray, list[str]]:
    """One solid, cavities included, of a closed mesh (n, 3), (m, 3) with consistent faces; and what was done.

    Raises:
        MeshError: its bodies do not touch, or its surface passes through itself.
    """
    notes: list[str] = []
    parts = [faces[label] for label in _components(faces, len(vertices))]
    volumes = np.array([_volume(vertices, part) for part in parts])
    outer = int(np.argmax(np.abs(volumes)))
    if volumes[outer] < 0:  # cavities are turned with it
        parts, volumes = [part[:, ::-1] for part in parts], -volumes
        notes.append("turned inside out: the normals looked inward")
    if len(parts) > 1:
        vertices, faces, more = _joined(vertices, parts, volumes)
        notes += more
    else:
        faces = parts[0]
    if _volume(vertices, faces) <= 1e-6 * float(np.prod(np.ptp(vertices, axis=0))):
        raise MeshError("a surface that encloses nothing", "a solid")
    return vertices, faces, notes


def check_crossing(vertices: Array, faces: np.ndarray) -> None:
    """Refuse a surface that passes through itself: rays enter what they are in, or leave what they are not in.

    Raises:
        MeshError: so it is.
    """
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    low, high = mesh.bounds
    rng = np.random.default_rng(3)
    along = rng.normal(size=(RAYS, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    start = rng.uniform(low, high, (RAYS, 3)) - along * np.linalg.norm(high - low)
    hits, ray, face = mesh.ray.intersects_location(start, along, multiple_hits=True)
    far = np.einsum("ij,ij->i", hits - start[ray], along[ray])
    order = np.lexsort((far, ray))
    ray, enters = ray[order], -np.sign(np.einsum("ij,ij->i", mesh.face_normals[face], along[ray]))[order]
    depth = np.cumsum(enters) - np.concatenate([[0.0], np.cumsum(np.bincount(ray, enters, RAYS))])[ray]
    # a closed surface is left as often as it is entered; where not, the ray caster missed a hit near an edge
    told = np.bincount(ray, enters, RAYS) == 0
    bad = np.unique(ray[told[ray] & ((depth < -0.5) | (depth > 1.5))])
    share = len(bad) / max(int(told[np.unique(ray)].sum()), 1)
    if share > CROSSED:
        raise MeshError(
            f"a surface that passes through itself (seen by {100 * share:.0f} % of rays)",
            "a surface that bounds one solid; join its solids in the CAD and export again",
        )


def _joined(vertices: Array, parts: list[np.ndarray], volumes: Array) -> tuple[Array, np.ndarray, list[str]]:
    notes = []
    large = np.abs(volumes) > CRUMB * volumes.max()
    if not large.all():
        notes.append(f"left out {int((~large).sum())} bodies below {100 * CRUMB:g} % of the volume")
    bodies = [_solid(vertices, part) for part, keep in zip(parts, large & (volumes > 0), strict=True) if keep]
    hollow = [_solid(vertices, part[:, ::-1]) for part, keep in zip(parts, large & (volumes < 0), strict=True) if keep]
    whole = m3.Manifold.batch_boolean(bodies, m3.OpType.Add)
    apart = [body for body in whole.decompose() if body.volume() > 0]
    if len(apart) > 1:
        sizes = " and ".join(" x ".join(f"{1000 * s:.3g}" for s in _extents(body)) for body in apart[:3])
        raise MeshError(f"{len(apart)} bodies that do not touch ({sizes} mm)", "one solid; export each part by itself")
    if len(bodies) > 1:
        notes.append(f"joined {len(bodies)} bodies that overlap or touch")
    if hollow:
        whole = m3.Manifold.batch_boolean([whole, *hollow], m3.OpType.Subtract)
        notes.append(f"kept {len(hollow)} closed cavities")
    made = whole.to_mesh64()
    return np.asarray(made.vert_properties)[:, :3], np.asarray(made.tri_verts, dtype=np.int64), notes


def _components(faces: np.ndarray, n: int) -> list[np.ndarray]:
    a, b, c = faces.T
    links = coo_matrix((np.ones(2 * len(a)), (np.concatenate([a, b]), np.concatenate([b, c]))), shape=(n, n))
    _, label = connected_components(links, directed=False)
    of_face = label[a]
    kinds = np.flatnonzero(np.bincount(of_face))
    if len(kinds) > MANY:
        raise MeshError(f"{len(kinds)} bodies", "one solid; export each part by itself")
    return [of_face == k for k in kinds]


def is_used(vertices: Array, faces: np.ndarray) -> np.ndarray:
    """(n,) bool: a face has the vertex as a corner. `np.unique` takes seconds for a million faces."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces.ravel()] = True
    return used


def _volume(vertices: Array, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, k]] - vertices[faces[0, 0]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _solid(vertices: Array, faces: np.ndarray) -> m3.Manifold:
    used = is_used(vertices, faces)
    local = (np.cumsum(used) - 1)[faces]
    body = m3.Manifold(m3.Mesh64(vertices[used], local.astype(np.uint64)))
    if body.status() != m3.Error.NoError:
        raise MeshError(f"a surface that is no solid ({body.status().name})", "a closed surface with outward normals")
    return body


def _extents(body: m3.Manifold) -> Array:
    low, high = np.split(np.asarray(body.bounding_box()), 2)
    return np.asarray(high - low)
