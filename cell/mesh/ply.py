"""PLY read strictly: every element that the header declares must be there, whole, and nothing after the last.

trimesh reads no binary file whose faces differ in size, fans concave faces out, and takes rows that are there for rows
that were declared; so the rows are walked here, which is what comparing their number takes anyway.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import NoReturn

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.mesh.error import MeshError
from pickproof.cell.mesh.polygons import triangulate
from pickproof.cell.mesh.raw import RawMesh, check_corners, cut_short, padding

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "int64": "i8", "uint64": "u8", "float16": "f2", "float32": "f4", "float64": "f8",
}  # fmt: skip
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
HEADER = re.compile(rb"ply[ \t]*\r?[\n\r]([\s\S]*?)^end_header[ \t]*(?:\r\n|\n|\r)", re.MULTILINE)
INDICES = ("vertex_indices", "vertex_index")
MOST = 2**20
"""[byte] of a header."""

Columns = dict[str, "np.ndarray | list[np.ndarray]"]
"""Values of each property: (n,) of a scalar, (n, k) or n arrays of a list."""


@dataclass(frozen=True)
class Property:
    """A column; `count` is the type of a list's length, empty for a scalar. Types are those of numpy."""

    name: str
    type: str
    count: str = ""


@dataclass
class Element:
    """So many rows of some properties."""

    name: str
    rows: int
    properties: list[Property] = field(default_factory=list)

    @property
    def plural(self) -> str:
        """As a message names it."""
        return {"vertex": "vertices", "face": "faces"}.get(self.name, f"rows of `{self.name}`")


def read_ply(data: bytes) -> RawMesh:
    """Vertices and faces of an ASCII or a binary file.

    Raises:
        MeshError: it is not PLY, cut short, or holds more than it declares.
    """
    match = HEADER.match(data[:MOST])
    if match is None:
        end = ": the file was cut short" if data.startswith(b"ply") else ""
        raise MeshError(f"no header from `ply` to `end_header`{end}", "a PLY file")
    order, elements = _header(match[1].decode("latin-1").splitlines())
    body = data[match.end() :]
    tables, notes = _binary(body, elements, order) if order else _text(body, elements)
    vertices = _vertices(tables.get("vertex", {}))
    faces = tables.get("face", {})
    corners = next((faces[name] for name in INDICES if name in faces), None)
    if corners is None or len(corners) == 0:
        raise MeshError(f"no faces: {len(vertices)} vertices and no list vertex_indices", "a mesh with faces")
    sizes = np.array([len(row) for row in corners], dtype=np.int64)
    flat = np.concatenate(list(corners)) if isinstance(corners, list) else corners.ravel()
    if flat.dtype.kind == "f":
        raise MeshError("indices of vertices that are floating-point numbers", "integers")
    check_corners(flat, sizes, len(vertices))
    if (few := int((sizes < 3).sum())) > 0:
        notes += (f"passed over {few} faces of fewer than three corners",)
    return RawMesh(vertices, triangulate(vertices, flat.astype(np.int64), sizes), notes)


def _header(lines: list[str]) -> tuple[str, list[Element]]:
    """Order of bytes, empty for ASCII, and the elements in their order."""
    order, elements = None, list[Element]()
    for line in lines:
        word, *rest = line.split() or [""]
        try:
            if word == "format":
                order = ORDERS[rest[0]]
            elif word == "element":
                elements.append(Element(rest[0], int(rest[1])))
            elif word == "property" and rest[0] == "list":
                count, of, name = rest[1:]
                elements[-1].properties.append(Property(name, TYPES[of], TYPES[count]))
            elif word == "property":
                of, name = rest
                elements[-1].properties.append(Property(name, TYPES[of]))
            elif word not in ("", "comment", "obj_info"):
                raise ValueError
        except (KeyError, IndexError, ValueError):
            raise MeshError(f"`{line.strip()[:60]}` in the header", "format, element, property or comment") from None
    counts = [p.count for e in elements for p in e.properties]
    if order is None or any(e.rows < 0 for e in elements) or any(count.startswith("f") for count in counts):
        raise MeshError("a header without format, or with a count that is none", "a PLY file")
    if len({e.name for e in elements}) < len(elements):
        raise MeshError("a header that declares an element twice", "each once")
    return order, elements


def _vertices(columns: Columns) -> Array:
    if not all(isinstance(columns.get(axis), np.ndarray) for axis in "xyz"):
        raise MeshError("no vertices with x, y and z", "a mesh with vertices")
    return np.stack([np.asarray(columns[axis], dtype=np.float64) for axis in "xyz"], axis=1)


def _binary(body: bytes, elements: list[Element], order: str) -> tuple[dict[str, Columns], tuple[str, ...]]:
    tables, at = dict[str, Columns](), 0
    for element in elements:
        found = _even(body, at, element, order)
        tables[element.name], at = _walked(body, at, element, order) if found is None else found
    return tables, padding(body[at:], f"declared {elements[-1].plural}" if elements else "header")


def _even(body: bytes, at: int, element: Element, order: str) -> tuple[Columns, int] | None:
    """The rows and where they end, where all lists are as long as those of the first row; None where not."""
    if element.rows == 0:
        return {}, at
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    to = at
    for i, p in enumerate(element.properties):
        if p.count:
            length = _first(body, to, order + p.count)
            if not 0 <= length <= len(body):
                return None
            fields += [(f"n{i}", order + p.count), (f"p{i}", order + p.type, (length,))]
            to += np.dtype(p.count).itemsize + length * np.dtype(p.type).itemsize
        else:
            fields.append((f"p{i}", order + p.type))
            to += np.dtype(p.type).itemsize
        if to - at > len(body):
            return None
    row = np.dtype(fields)
    if element.rows * row.itemsize > len(body) - at:
        return None
    rows = np.frombuffer(body, row, element.rows, at) if row.itemsize else np.zeros(0, row)
    if any((rows[f"n{i}"] != rows.dtype[f"p{i}"].shape[0]).any() for i, p in enumerate(element.properties) if p.count):
        return None
    return {p.name: rows[f"p{i}"] for i, p in enumerate(element.properties)}, at + element.rows * row.itemsize


def _first(body: bytes, at: int, of: str) -> int:
    """The integer at a place, -1 beyond the end."""
    size = np.dtype(of).itemsize
    return int(np.frombuffer(body, of, 1, at)[0]) if 0 <= at <= len(body) - size else -1


def _walked(body: bytes, at: int, element: Element, order: str) -> tuple[Columns, int]:
    """The rows and where they end, row by row."""
    kinds = [(p, np.dtype(order + p.type), np.dtype(order + p.count) if p.count else None) for p in element.properties]
    least = sum((count or kind).itemsize for _, kind, count in kinds)
    if not any(count for _, _, count in kinds):
        raise cut_short((len(body) - at) // least, element.rows, element.plural)
    columns: dict[str, list[np.ndarray]] = {p.name: [] for p in element.properties}
    for row in range(element.rows):
        for p, kind, count in kinds:
            length = 1
            if count is not None:
                length = _first(body, at, count.str)
                at += count.itemsize
            if length < 0 or at + length * kind.itemsize > len(body):
                raise cut_short(row, element.rows, element.plural)
            columns[p.name].append(np.frombuffer(body, kind, length, at))
            at += length * kind.itemsize
    return {p.name: columns[p.name] if p.count else np.concatenate(columns[p.name]) for p in element.properties}, at


def _text(body: bytes, elements: list[Element]) -> tuple[dict[str, Columns], tuple[str, ...]]:
    if b"_" in body:  # Python and numpy read 1_0 as ten
        raise MeshError("`_` among the rows", "numbers")
    lines = [words for line in body.splitlines() if (words := line.strip(b"\0").split())]
    tables, at = dict[str, Columns](), 0
    for element in elements:
        rows = lines[at : at + element.rows]
        at += len(rows)
        tables[element.name] = _of_text(rows, element, at == len(lines))
        if len(rows) < element.rows:
            raise cut_short(len(rows), element.rows, element.plural)
    if at < len(lines):
        raise MeshError(f"{len(lines) - at} lines after the declared rows", "a file that ends with what it declares")
    return tables, ()


def _of_text(rows: list[list[bytes]], element: Element, is_end: bool) -> Columns:
    """Columns of rows of words; `is_end`: the last of them is the last of the file, which may be cut short."""

    def broken(i: int) -> NoReturn:
        if is_end and i == len(rows) - 1:
            raise cut_short(i, element.rows, element.plural)
        shown = b" ".join(rows[i])[:40].decode("ascii", "replace")
        raise MeshError(f"`{shown}`, row {i + 1} of {element.rows} {element.plural}", "the values that are declared")

    if (even := _even_text(rows, element)) is not None:
        return even
    columns: dict[str, list[np.ndarray]] = {p.name: [] for p in element.properties}
    for i, words in enumerate(rows):
        at, values = 0, np.array(_numbers(words))
        for p in element.properties:
            length = 1
            if p.count:
                length = int(values[at]) if at < len(values) and 0 <= values[at] <= len(values) else len(values)
                at += 1
            if at + length > len(values):
                broken(i)
            columns[p.name].append(values[at : at + length])
            at += length
        if at != len(values):
            broken(i)
    return {p.name: _listed(columns[p.name], p) for p in element.properties}


def _even_text(rows: list[list[bytes]], element: Element) -> Columns | None:
    """Columns where all rows are alike in their lengths, None where not."""
    if not rows or any(len(words) != len(rows[0]) for words in rows):
        return None
    try:
        table = np.array(rows).astype(np.float64)
    except ValueError:
        return None
    columns, at = Columns(), 0
    for p in element.properties:
        length = 1
        if p.count:
            length, at = int(np.nan_to_num(table[0, min(at, len(rows[0]) - 1)])), at + 1
            if not 0 <= length <= table.shape[1] - at or (table[:, at - 1] != length).any():
                return None
        if at + length > table.shape[1]:
            return None
        if p.count and p.type[0] != "f":
            columns[p.name] = _whole(table[:, at : at + length], p)
        else:
            columns[p.name] = table[:, at : at + length] if p.count else table[:, at]
        at += length
    return columns if at == table.shape[1] else None


def _whole(values: np.ndarray, of: Property) -> np.ndarray:
    if not ((values == np.rint(values)) & (np.abs(values) < 2**40)).all():
        raise MeshError(f"a {of.name} that is no integer", "integers, as the header declares")
    return values.astype(np.int64)


def _listed(values: list[np.ndarray], of: Property) -> np.ndarray | list[np.ndarray]:
    if not of.count:
        return np.concatenate(values) if values else np.zeros(0)
    if of.type[0] == "f":
        return values
    return [_whole(v, of) for v in values]


def _numbers(words: list[bytes]) -> list[float]:
    try:
        return [float(w) for w in words]
    except ValueError:
        shown = b" ".join(words)[:40].decode("ascii", "replace")
        raise MeshError(f"`{shown}` among the rows", "numbers") from None
