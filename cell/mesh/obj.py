"""Wavefront OBJ: vertices, faces of any size, objects.

trimesh counts negative indices from the end of the file in place of the vertices read so far, and fans concave faces
out; so the statements that carry the surface are read here. The format declares no counts: a file that was cut short
shows by vertices that nothing uses.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.mesh.error import MeshError
from pickproof.cell.mesh.polygons import triangulate
from pickproof.cell.mesh.raw import RawMesh

CORNER = re.compile(rb"(-?\d+)(?:/-?\d*){0,2}")
SURFACES = frozenset(b"surf bsp bzp cdc cdp call csh".split())
"""Statements of surfaces without faces, or of other files: what they add would be missing."""
PASSED = frozenset(
    b"vt vn vp cstype deg bmat step curv curv2 parm trim hole scrv sp end con g s mg o bevel c_interp d_interp lod "
    b"maplib usemap usemtl mtllib shadow_obj trace_obj ctech stech res".split()
)


@dataclass
class ObjFile:
    """What stands in a file.

    Attributes:
        points: coordinates, three for each vertex.
        corners: indices of vertices from 0, face after face; sizes: corners of each face; lines: where it stands.
        used: indices of vertices that points and lines use.
        objects: number of vertices before each `o`; last: name of the last one while nothing of it has come.
        unknown: statements that the format does not have.
    """

    points: list[float] = field(default_factory=list)
    corners: list[int] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    used: list[int] = field(default_factory=list)
    objects: list[int] = field(default_factory=list)
    last: str = ""
    unknown: list[str] = field(default_factory=list)

    @property
    def vertices(self) -> Array:
        """(n, 3)."""
        return np.array(self.points, dtype=np.float64).reshape(-1, 3)


def scan_obj(data: bytes) -> ObjFile:
    """Read the statements of vertices, faces and objects.

    Raises:
        MeshError: a statement that is not valid; it names the line.
    """
    found = ObjFile()
    for line, (word, *rest) in _statements(data):
        if word in (b"f", b"fo", b"p", b"l"):
            found.last = ""
        if word == b"v":
            found.points += _coordinates(rest, line)
        elif word in (b"f", b"fo"):  # `fo` is the older word
            found.corners += _indices(rest, len(found.points) // 3, line)
            found.sizes.append(len(rest))
            found.lines.append(line)
            if len(rest) < 3:
                raise MeshError(f"a face of {len(rest)} corners in line {line}", "at least three")
        elif word in (b"p", b"l"):
            found.used += _indices(rest, len(found.points) // 3, line)
        elif word in SURFACES:
            raise MeshError(f"`{word.decode()}` in line {line}: a surface without faces", "faces (`f`) alone")
        elif word == b"o":
            found.objects.append(len(found.points) // 3)
            found.last = b" ".join([word, *rest])[:40].decode("utf-8", "replace")
        elif word not in PASSED:
            found.unknown.append(f"line {line}: {word[:20].decode('ascii', 'replace')}")
    return found


def read_obj(data: bytes) -> RawMesh:
    """The surface of a file as triangles.

    Raises:
        MeshError: a statement that is not valid, indices without vertices, or vertices that nothing uses.
    """
    found = scan_obj(data)
    vertices, corners, sizes = found.vertices, np.array(found.corners, np.int64), np.array(found.sizes, np.int64)
    if len(sizes) == 0:
        raise MeshError(f"no faces: {len(vertices)} vertices and no `f`", "a mesh with faces")
    beyond = np.flatnonzero(corners >= len(vertices))
    if len(beyond):
        line = found.lines[int(np.searchsorted(np.cumsum(sizes), beyond[0], side="right"))]
        raise MeshError(
            f"vertex {corners[beyond[0]] + 1} of {len(vertices)} in line {line}", "indices of vertices that are there"
        )
    if found.last:
        raise MeshError(
            f"`{found.last}` at the end without faces: the file was cut short", "all of it; export it again"
        )
    _check_loose(vertices, corners, np.array(found.used, np.int64))
    notes: tuple[str, ...] = ()
    if found.unknown:
        notes = (f"passed over {len(found.unknown)} statements that OBJ does not have ({found.unknown[0]})",)
    return RawMesh(vertices, triangulate(vertices, corners, sizes), notes)


def _statements(data: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """Words of each statement, with the line where it ends; a backslash at the end of a line goes on in the next."""
    held, line = b"", 0
    for line, text in enumerate(data.removeprefix(b"\xef\xbb\xbf").splitlines(), 1):
        text = held + text.partition(b"#")[0]
        held = b""
        if text.endswith(b"\\"):
            held = text[:-1] + b" "
        elif words := text.split():
            yield line, words
    if words := held.split():
        yield line, words


def _coordinates(words: list[bytes], line: int) -> list[float]:
    """x, y, z; a weight and a colour may follow."""
    try:
        numbers = [float(w) for w in words]
    except ValueError:
        numbers = []
    if len(numbers) not in (3, 4, 6, 7) or any(b"_" in w for w in words):
        shown = b" ".join(words)[:40].decode("ascii", "replace")
        raise MeshError(f"`v {shown}` in line {line}", "v x y z") from None
    return numbers[:3]


def _indices(words: list[bytes], n: int, line: int) -> list[int]:
    """Indices from 0 of `i`, `i/j`, `i//k`, `i/j/k`; a negative one counts back from the `n` vertices read so far."""
    indices = []
    for word in words:
        match = CORNER.fullmatch(word)
        i = int(match[1]) if match and len(match[1]) < 16 else 0
        if i == 0 or i < -n:
            shown = word[:20].decode("ascii", "replace")
            raise MeshError(f"corner `{shown}` in line {line}, after {n} vertices", "1 and up, or -1 and down, to them")
        indices.append(i - 1 if i > 0 else n + i)
    return indices


def _check_loose(vertices: Array, corners: np.ndarray, others: np.ndarray) -> None:
    """Vertices that nothing uses, apart from those that are used, are of faces that are missing."""
    used = np.zeros(len(vertices), dtype=bool)
    used[corners] = True
    used[others[others < len(vertices)]] = True
    if used.all():
        return
    there = set(map(tuple, vertices[used].tolist()))
    loose = sum(tuple(v) not in there for v in vertices[~used].tolist())
    if loose:
        raise MeshError(
            f"{loose} of {len(vertices)} vertices that no face uses: the file was cut short, or faces are missing",
            "a file whose faces use its vertices; export it again",
        )
