"""Closed polyhedra of known volume, and writers of them as OBJ, STL, PLY and GLB with what each format allows."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import manifold3d as m3
import numpy as np
import trimesh

from pickproof.cell.frames import Array, random_rotations

VOLUME = 24_000.0
"""[mm3] of every solid."""


@dataclass(frozen=True)
class Solid:
    """Bodies of vertices (n, 3) in [mm] and polygons with outward normals, which overlap and enclose VOLUME."""

    bodies: list[tuple[Array, list[list[int]]]]

    @property
    def merged(self) -> tuple[Array, list[list[int]]]:
        """All bodies over one list of vertices."""
        offsets = np.cumsum([0, *(len(v) for v, _ in self.bodies)])
        faces = [[int(o) + i for i in f] for o, (_, fs) in zip(offsets, self.bodies, strict=False) for f in fs]
        return np.concatenate([v for v, _ in self.bodies]), faces

    @property
    def triangles(self) -> Array:
        """(m, 3, 3) corners."""
        return np.concatenate([v[np.array(_triangles(v, faces))] for v, faces in self.bodies])


def random_solid(rng: np.random.Generator) -> Solid:
    """A box, a prism over a concave polygon, or a prism with a box through it, turned at random."""
    kind = rng.integers(3)
    if kind == 0:
        bodies = [_prism(np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * rng.uniform(0.5, 1.5, 2), 2.0)]
    else:
        bodies = [_prism(_star(rng, int(rng.integers(5, 13))), float(rng.uniform(0.6, 2.0)))]
    if kind == 2:
        bodies.append(_prism(np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.25, 4.0))
    whole = m3.Manifold.batch_boolean([_manifold(*b) for b in bodies], m3.OpType.Add)
    R = random_rotations(1, rng)[0] * (VOLUME / whole.volume()) ** (1 / 3)
    shift = rng.uniform(-50, 50, 3)
    return Solid([(v @ R.T + shift, faces) for v, faces in bodies])


def _star(rng: np.random.Generator, n: int) -> Array:
    """A simple polygon (n, 2) round the origin whose radius jumps from corner to corner."""
    angles = (np.arange(n) + rng.uniform(-0.3, 0.3, n)) * 2 * np.pi / n
    radii = np.where(np.arange(n) % 2, rng.uniform(0.5, 0.7), rng.uniform(1.0, 1.4)) * rng.uniform(0.9, 1.1, n)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1) * radii[:, None]


def _prism(outline: Array, height: float) -> tuple[Array, list[list[int]]]:
    n = len(outline)
    low = np.column_stack([outline, np.full(n, -height / 2)])
    sides = [[i, (i + 1) % n, n + (i + 1) % n, n + i] for i in range(n)]
    vertices = np.concatenate([low, low + np.array((0, 0, height))])
    return vertices, [list(range(n))[::-1], list(range(n, 2 * n)), *sides]


def _triangles(vertices: Array, faces: list[list[int]]) -> list[list[int]]:
    """Of a prism: only its two ends may be concave, so they are cut in their own outline."""
    (low, high, *sides), n = faces, len(faces[0])
    height = vertices[n] - vertices[0]
    u = vertices[1] - vertices[0]
    axes = np.stack([u, np.cross(height, u)], axis=1)
    outline = vertices[:n] @ (axes / np.linalg.norm(axes, axis=0))
    cut = np.asarray(m3.triangulate([outline])).tolist()
    ends = [[low[n - 1 - i] for i in reversed(t)] for t in cut] + [[high[i] for i in t] for t in cut]
    return ends + [[a, b, c] for a, b, c, _ in sides] + [[a, c, d] for a, _, c, d in sides]


def _manifold(vertices: Array, faces: list[list[int]]) -> m3.Manifold:
    return m3.Manifold(m3.Mesh64(vertices, np.array(_triangles(vertices, faces), dtype=np.uint64)))


def obj_text(solid: Solid, rng: np.random.Generator) -> bytes:
    """Indices positive or negative, with or without those of textures and normals, lines broken, CRLF or not."""
    negative, style, breaks = rng.random() < 0.5, int(rng.integers(4)), rng.random() < 0.3
    lines, before = ["# a comment", "mtllib none.mtl", "vn 0 0 1", "vt 0 0"], 0
    for k, (vertices, faces) in enumerate(solid.bodies):
        lines += [f"o body{k}", f"g group{k}", *(f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()), "s off"]
        for face in faces:
            own = [i - len(vertices) if negative else before + i + 1 for i in face]
            words = [(f"{i}", f"{i}/1", f"{i}//1", f"{i}/1/-1")[style] for i in own]
            lines.append("f " + (" \\\n" if breaks else " ").join(words))
        before += len(vertices)
    return ("\n".join(lines) + "\n").replace("\n", "\r\n" if rng.random() < 0.3 else "\n").encode()


def stl_text(solid: Solid, rng: np.random.Generator) -> bytes:
    """A solid for each body."""
    lines = []
    for k, (vertices, faces) in enumerate(solid.bodies):
        lines.append(f"solid vertex plate {k}")
        for t in _triangles(vertices, faces):
            lines += [
                "facet normal 0 0 0",
                "outer loop",
                *("vertex {!r} {!r} {!r}".format(*vertices[i].tolist()) for i in t),
            ]
            lines += ["endloop", "endfacet"]
        lines.append(f"endsolid vertex plate {k}")
    return ("\n".join(lines) + "\n").replace("\n", "\r\n" if rng.random() < 0.3 else "\n").encode()


def stl_binary(solid: Solid, rng: np.random.Generator) -> bytes:
    """The header begins with the word `solid` in half of the files."""
    head = (b"solid of a careless writer" if rng.random() < 0.5 else b"COLOR=").ljust(80, b"\0 "[rng.integers(2) :][:1])
    records = np.zeros(len(solid.triangles), [("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    records["c"], records["a"] = solid.triangles, rng.integers(2**16)
    return head + struct.pack("<I", len(records)) + records.tobytes()


def ply(solid: Solid, rng: np.random.Generator) -> bytes:
    """ASCII, or binary in either order of bytes; polygons or triangles; further properties and elements."""
    order = ("ascii", "binary_little_endian", "binary_big_endian")[rng.integers(3)]
    vertices, faces = solid.merged
    if rng.random() < 0.3:
        vertices = solid.triangles.reshape(-1, 3)
        faces = np.arange(len(vertices)).reshape(-1, 3).tolist()
    flags, edges = rng.random() < 0.5, int(rng.integers(3))
    head = f"ply\nformat {order} 1.0\ncomment of a test\nelement vertex {len(vertices)}\nproperty uchar quality\n"
    head += "property double x\nproperty double y\nproperty double z\n"
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\n" + "property uchar flags\n" * flags
    head += f"element edge {edges}\nproperty int vertex1\nproperty int vertex2\n" + "end_header\n"
    if order == "ascii":
        rows = [f"7 {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
        rows += [f"{len(f)} {' '.join(map(str, f))}{' 1' * flags}" for f in faces] + ["0 1"] * edges
        return (head + "\n".join(rows) + "\n").encode()
    e = "<" if "little" in order else ">"
    parts = [struct.pack(e + "Bddd", 7, *v) for v in vertices.tolist()]
    parts += [struct.pack(e + f"B{len(f)}i" + "B" * flags, len(f), *f, *[1] * flags) for f in faces]
    return head.encode() + b"".join(parts) + struct.pack(e + "ii", 0, 1) * edges


def glb(solid: Solid, rng: np.random.Generator) -> bytes:
    """A mesh for each body."""
    bodies = {
        str(k): trimesh.Trimesh(v, _triangles(v, faces), process=False) for k, (v, faces) in enumerate(solid.bodies)
    }
    return bytes(trimesh.Scene(bodies).export(file_type="glb"))


WRITERS = {"obj": [obj_text], "stl": [stl_text, stl_binary], "ply": [ply], "glb": [glb]}
