"""Check that a point cloud file holds as many points as it declares; readers accept a truncated file silently."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pickproof.cell.errors import InputError

PLY_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
NUMBER = tuple(bytes([c]) for c in b"+-.0123456789nNiI")
"""Characters that can start a line with a point; nan and inf are numbers."""
IN_NUMBERS = np.isin(np.arange(256), np.frombuffer(b"+-.0123456789eEnNaAiIfFtTyY", np.uint8))
BLANK = np.isin(np.arange(256), np.frombuffer(b" \t\n\v\f\r", np.uint8))
MOST_HEADER = 100_000


@dataclass
class _Element:
    """An element of a PLY header: bytes of its scalar properties; `has_list` where its size is not fixed."""

    name: str
    count: int
    sizes: list[int] = field(default_factory=list)
    has_list: bool = False


def check_count(path: Path) -> None:
    """Compare the declared number of points with that in the file; in XYZ, check that all lines are equally long.

    Raises:
        InputError: there are fewer or more, the header does not say, or lines hold different counts of numbers.
    """
    counted = {".ply": _ply, ".pcd": _pcd, ".pts": _pts}.get(path.suffix.lower(), _xyz)
    try:
        declared, found = counted(path.read_bytes())
    except (ValueError, IndexError, KeyError) as error:
        raise InputError(
            path, "", str(error), f"a point cloud with points, as {path.suffix[1:].upper()} has them"
        ) from None
    if declared != found:
        short = "; the file was cut short" if found < declared else ""
        raise InputError(path, "points", f"{found} in the file", f"{declared} as its header declares{short}")


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

    if binary:
        held = len(body) - sum(e.count * sum(e.sizes) for e in before)
        whole = max(held, 0) // sum(vertex.sizes)
    else:
        first = sum(e.count for e in before)
        last = None if at == len(elements) - 1 else first + vertex.count
        whole = _rows(b"\n".join(_lines(body)[first:last]), len(vertex.sizes))
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
        return declared, _rows(body, sum(counts))
    for name, width, letter in zip(fields["FIELDS"], fields["SIZE"], fields["TYPE"], strict=True):
        if name in ("x", "y", "z") and (width, letter) != ("4", "F"):  # the reader replaces such values by 0
            raise ValueError(f"{name} of SIZE {width} and TYPE {letter}, not of 4 and F")
    if kind == b"binary":
        return declared, len(body) // size
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
    lines = _lines(content)
    return int(lines[0]), _rows(b"\n".join(lines[1:]))


def _xyz(content: bytes) -> tuple[int, int]:
    lines = [line for line in _lines(content) if line.strip() and not line.lstrip().startswith(b"#")]
    first = next((i for i, line in enumerate(lines) if line.lstrip().startswith(NUMBER)), len(lines))  # after titles
    return len(lines) - first, _rows(b"\n".join(lines[first:]))


def _split(content: bytes, end: bytes) -> tuple[str, bytes]:
    """The header up to the line that starts with `end`, and the data after it."""
    start = 0 if content.startswith(end) else content.find(b"\n" + end) + 1
    if start == 0 and not content.startswith(end):
        raise ValueError(f"no {end.decode()}")
    after = start + len(end)
    if end == b"end_header":
        after = content.index(b"\n", after) + 1
    return content[:start].decode("ascii", errors="replace"), content[after:]


def _lines(body: bytes) -> list[bytes]:
    return [line for line in body.splitlines() if line.strip()]


def _rows(body: bytes, width: int | None = None) -> int:
    """Number of lines with `width` numbers (default: as in the first line); a truncated last line does not count.

    Raises:
        ValueError: a line before the last has a different count of numbers, or holds something else.
    """
    text = np.frombuffer(b"\n" + body, np.uint8)
    blank, line = BLANK[text], np.cumsum((text == 10) | (text == 13)) - 1
    other = np.flatnonzero(~blank & ~IN_NUMBERS[text])
    if len(other):
        raise ValueError(f"{chr(text[other[0]])!r} among the numbers of row {line[other[0]] + 1}")
    counts = np.bincount(line[1:][blank[:-1] & ~blank[1:]], minlength=1)
    counts = counts[counts > 0]
    if not len(counts):
        return 0
    width = width or int(counts[0])
    odd = np.flatnonzero(counts != width)
    if len(odd) and (odd[0] < len(counts) - 1 or counts[-1] > width):
        raise ValueError(f"row {odd[0] + 1} of {counts[odd[0]]} numbers among rows of {width}")
    return len(counts) - len(odd)
