"""STL read strictly: the declared count against the size, every ASCII facet whole.

trimesh takes a binary file for text when its count is wrong, and an ASCII file for empty when its end is missing; both
then have "no faces". The check walks over all of the content, so it yields the numbers as well.
"""

from __future__ import annotations

import re

import numpy as np

from pickproof.cell.mesh.error import MeshError
from pickproof.cell.mesh.raw import PADDING, RawMesh, cut_short, padding

HEAD = 84
"""[byte] of header and count of a binary file."""
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_VERTEX = rb"vertex" + 3 * rb"\s+([-+.a-z0-9]+)" + rb"\s+"
FACET = re.compile(
    rb"\bfacet\s+normal\s+\S+\s+\S+\s+\S+\s+outer\s+loop\s+" + 3 * _VERTEX + rb"endloop\s+endfacet\b", re.IGNORECASE
)
TEXT = re.compile(rb"\s*solid\b[\s\S]*?(facet\s+normal|endsolid)\b", re.IGNORECASE)
PRINTED = bytes(range(9, 14)) + bytes(range(32, 127))
MUCH = 2**16
"""[byte] at the beginning that tell text from numbers."""
WHOLE = "whole facets between `solid` and `endsolid`; export it again"


def read_stl(data: bytes) -> RawMesh:
    """The triangles of a binary or an ASCII file.

    Raises:
        MeshError: it is not STL, cut short, or holds more than it declares.
    """
    data = data.removeprefix(b"\xef\xbb\xbf")
    if not data.strip(PADDING):
        raise MeshError("no faces: the file is empty", "a mesh with faces")
    # some binary files begin with the word `solid`, so the count speaks first; no text is long enough for the count
    # that its characters would be
    if _declared(data) * RECORD.itemsize == len(data) - HEAD:
        return _read_binary(data)
    is_text = not data[:MUCH].translate(None, PRINTED)
    if is_text and not data.lstrip().lower().startswith(b"solid"):
        raise MeshError("text that does not begin with `solid`", WHOLE)
    return _read_text(data) if is_text or TEXT.match(data[:MUCH]) else _read_binary(data)


def _declared(data: bytes) -> int:
    return int.from_bytes(data[80:HEAD], "little")


def _read_binary(data: bytes) -> RawMesh:
    if len(data) < HEAD:
        raise MeshError(f"{len(data)} bytes, less than the header of a binary STL", f"{HEAD} bytes and its triangles")
    declared, room = _declared(data), (len(data) - HEAD) // RECORD.itemsize
    if room < declared:
        raise cut_short(room, declared, "triangles")
    rest = data[HEAD + declared * RECORD.itemsize :]
    if declared == 0 and not rest.strip(PADDING):
        raise MeshError("no faces: 0 declared triangles", "a mesh with faces")
    extra = f", room for {room - declared} more" if room > declared else ""
    notes = padding(rest, f"{declared} declared triangles{extra}")
    records = np.frombuffer(data, RECORD, declared, HEAD)
    vertices = records["corners"].reshape(-1, 3).astype(np.float64)
    return RawMesh(vertices, np.arange(3 * declared).reshape(-1, 3), notes)


def _read_text(data: bytes) -> RawMesh:
    facets = FACET.findall(data)
    _check_frame(FACET.sub(b"\n", data), len(facets))
    if not facets:
        raise MeshError("no faces: 0 facets", "a mesh with faces")
    try:
        vertices = np.array(facets).astype(np.float64).reshape(-1, 3)
    except ValueError:
        raise MeshError("a vertex whose coordinates are no numbers", "three numbers for each vertex") from None
    return RawMesh(vertices, np.arange(len(vertices)).reshape(-1, 3))


def _check_frame(rest: bytes, facets: int) -> None:
    """What is left without whole facets must be pairs of lines `solid NAME` and `endsolid NAME`."""
    is_open = False
    for line in rest.splitlines():
        word = line.split()[0].lower() if line.strip(PADDING) else b""
        if word == (b"endsolid" if is_open else b"solid"):
            is_open = not is_open
        elif word:
            shown = line.strip(PADDING)[:30].decode("ascii", "replace")
            raise MeshError(f"{facets} whole facets, and one that is broken at {shown!r}", WHOLE)
    if is_open:
        raise MeshError(f"{facets} whole facets and no endsolid: the file was cut short", WHOLE)
