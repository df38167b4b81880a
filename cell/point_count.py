"""Whether a cloud's file holds as many points as it declares: readers pass over what was cut off."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cell.errors import InputError

PLY_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
NUMBER = tuple("+-.0123456789nNiI")
"""First characters of a line that holds a point; nan and inf are numbers."""
MOST_HEADER = 100_000


@dataclass
class _Element:
    """Of a PLY header: its scalar properties as bytes; `has_list` where its size is not fixed."""

    name: str
    count: int
    sizes: list[int] = field(default_factory=list)
    has_list: bool = False


def check_count(path: Path) -> None:
    """Compare declared points with those that the file holds, of PLY, PCD and PTS.

    Raises:
        InputError: there are fewer or more, or the header does not say.
    """
    counted = {".ply": _ply, ".pcd": _pcd, ".pts": _pts}.get(path.suffix.lower())
    if counted is None:
        return
    try:
        declared, found = counted(path.read_bytes())
    except (ValueError, IndexError, KeyError) as error:
        valid = f"a point cloud with points; its header is not that of {path.suffix.lower()[1:].upper()}"
        raise InputError(path, "", str(error) or "unreadable header", valid) from None
    if declared != found:
        short = "; the file was cut short" if found < declared else ""
        raise InputError(path, "points", f"{found} in the file", f"{declared} as its header declares{short}")


def point_lines(path: Path) -> int:
    """Lines of an XYZ file that hold a point; titles and comments do not."""
    return sum(line.lstrip().startswith(NUMBER) for line in path.read_text(errors="replace").splitlines())


def _ply(content: bytes) -> tuple[int, int]:
    header, body = _split(content, b"end_header")
    elements: list[_Element] = []
    binary = False
    for word, *rest in (line.split() for line in header.splitlines() if line.strip()):
        if word == "format":
            binary = rest[0] != "ascii"
        elif word == "element":
            elements.append(_Element(rest[0], int(rest[1])))
        elif word == "property" and rest[0] == "list":
            elements[-1].has_list = True
        elif word == "property":
            elements[-1].sizes.append(PLY_BYTES[rest[0]])
    names = [element.name for element in elements]
    if not header.startswith("ply") or "vertex" not in names:
        raise ValueError("no vertices declared")
    at = names.index("vertex")
    vertex, before = elements[at], elements[:at]
    if vertex.has_list or not vertex.sizes or any(e.has_list and e.count for e in before):
        raise ValueError("vertices with lists, or after lists")

    def span(element: _Element) -> int:
        return sum(element.sizes) if binary else len(element.sizes)

    held = (len(body) if binary else _words(body)) - sum(e.count * span(e) for e in before)
    whole = max(held, 0) // span(vertex)
    # faces and the like may follow
    return vertex.count, whole if at == len(elements) - 1 else min(whole, vertex.count)


def _pcd(content: bytes) -> tuple[int, int]:
    header, body = _split(content, b"DATA")
    fields = pcd_header(header)
    kind = body[: body.index(b"\n")].strip()
    body = body[body.index(b"\n") + 1 :]
    counts = [int(x) for x in fields["COUNT"]] if "COUNT" in fields else [1] * len(fields["FIELDS"])
    declared = int(fields["WIDTH"][0]) * int(fields["HEIGHT"][0])
    if "POINTS" in fields and int(fields["POINTS"][0]) != declared:
        raise ValueError(f"POINTS {fields['POINTS'][0]}, but WIDTH x HEIGHT {declared}")
    size = sum(int(s) * n for s, n in zip(fields["SIZE"], counts, strict=True))
    if kind == b"ascii":
        return declared, _words(body) // sum(counts)
    if kind == b"binary":
        return declared, min(len(body) // size, declared)  # writers pad
    packed, unpacked = (int(x) for x in np.frombuffer(body[:8], "<u4"))
    held = unpacked // size if len(body) >= 8 + packed else int(unpacked * (len(body) - 8) / max(packed, 1)) // size
    return declared, held


def pcd_header(header: str) -> dict[str, list[str]]:
    """Words after each name of a PCD header."""
    lines = (line.split() for line in header.splitlines() if line.strip() and not line.startswith("#"))
    return {word: rest for word, *rest in lines}


def pcd_viewpoint(path: Path) -> tuple[float, ...] | None:
    """x, y, z [unit of the file] and quaternion w, x, y, z of a PCD file's sensor; None where it is the identity.

    Raises:
        InputError: they are not seven finite numbers with a rotation among them.
    """
    with path.open("rb") as file:
        words = pcd_header(_split(file.read(MOST_HEADER), b"DATA")[0]).get("VIEWPOINT")
    if words is None:
        return None
    try:
        values = tuple(float(word) for word in words)
    except ValueError:
        values = ()
    if len(values) != 7 or not np.isfinite(values).all() or abs(np.linalg.norm(values[3:]) - 1) > 1e-3:
        raise InputError(path, "VIEWPOINT", " ".join(words), "x y z and a unit quaternion w x y z")
    is_identity = max(map(abs, values[:3])) < 1e-9 and abs(abs(values[3]) - 1) < 1e-9
    return None if is_identity else values


def _pts(content: bytes) -> tuple[int, int]:
    lines = [line for line in content.splitlines() if line.strip()]
    return int(lines[0]), len(lines) - 1


def _split(content: bytes, end: bytes) -> tuple[str, bytes]:
    """The header up to the line that starts with `end`, and what follows that word; of PLY, its line."""
    start = 0 if content.startswith(end) else content.find(b"\n" + end) + 1
    if start == 0 and not content.startswith(end):
        raise ValueError(f"no {end.decode()}")
    after = start + len(end)
    if end == b"end_header":
        after = content.index(b"\n", after) + 1
    return content[:start].decode("ascii", errors="replace"), content[after:]


def _words(body: bytes) -> int:
    """How many words, parted by white space, a text has."""
    blank = np.frombuffer(b" " + body, np.uint8) <= 32
    return int((blank[:-1] & ~blank[1:]).sum())
