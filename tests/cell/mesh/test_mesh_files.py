"""Files of each format: what the format allows is read, what is not whole is refused with the counts."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pickproof.cell.errors import InputError
from pickproof.cell.mesh.check import check_size
from pickproof.cell.mesh.checked import as_trimesh
from pickproof.cell.mesh.crossing import check_crossing
from pickproof.cell.mesh.error import MeshError
from pickproof.cell.mesh.polygons import triangulate
from pickproof.cell.mesh.read import read_checked, read_checked_here
from tests.cell.mesh.step_box import step_box

BOX = trimesh.creation.box((40, 30, 20))
CORNERS = [(0, 0), (40, 0), (40, 10), (10, 10), (10, 30), (0, 30)]
ANGLE = [(*c, z) for z in (0, 20) for c in CORNERS]
"""An L of 40 x 30 x 20 mm and 12,000 mm3 with walls 10 mm thick: its two ends are concave."""
FACES = [[5, 4, 3, 2, 1, 0], [6, 7, 8, 9, 10, 11], *([i, (i + 1) % 6, 6 + (i + 1) % 6, 6 + i] for i in range(6))]


def obj(corner: Callable[[int], str] = lambda i: str(i + 1), newline: str = "\n") -> str:
    lines = [f"v {x} {y} {z}" for x, y, z in ANGLE] + ["f " + " ".join(map(corner, face)) for face in FACES]
    return newline.join(lines) + newline


def two_boxes() -> str:
    """Each box with negative indices after its own vertices; the second stands up through the first one's top."""
    text = ""
    for size, lift in (((40, 30, 20), 0), ((10, 10, 30), 20)):
        box = trimesh.creation.box(size).apply_translation((0, 0, lift))
        text += "o box\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in box.vertices)
        text += "".join("f {} {} {}\n".format(*(face - 8)) for face in box.faces)
    return text


def ply(order: str, faces: list[list[int]] = FACES, declared: tuple[int, int] = (12, 8)) -> bytes:
    head = f"ply\nformat {order} 1.0\nelement vertex {declared[0]}\nproperty float x\nproperty float y\n"
    head += f"property float z\nelement face {declared[1]}\nproperty list uchar int vertex_index\nend_header\n"
    if order == "ascii":
        rows = [" ".join(map(str, v)) for v in ANGLE] + [f"{len(f)} {' '.join(map(str, f))}" for f in faces]
        return (head + "\n".join(rows) + "\n").encode()
    e = "<" if "little" in order else ">"
    rows_ = [struct.pack(e + "fff", *v) for v in ANGLE] + [struct.pack(f"{e}B{len(f)}i", len(f), *f) for f in faces]
    return head.encode() + b"".join(rows_)


def stl(mesh: trimesh.Trimesh = BOX, count: int | None = None, head: bytes = b"", rest: bytes = b"") -> bytes:
    data = bytes(mesh.export(file_type="stl"))
    return head.ljust(80) + struct.pack("<I", len(mesh.faces) if count is None else count) + data[84:] + rest


def stl_text(name: str = "part") -> str:
    return str(BOX.export(file_type="stl_ascii")).replace("solid", f"solid {name}", 1)


def obj_of(kind: str) -> str:
    return {
        "negative": obj(lambda i: str(i - 12)),
        "textures": obj(lambda i: f"{i + 1}/1"),
        "normals": obj(lambda i: f"{i + 1}//2"),
        "both, CRLF": obj(lambda i: f"{i + 1}/1/-2", "\r\n"),
        "continued": obj().replace(" 4", " \\\n 4"),
        "comments": "# v 1 2 3\n" + obj().replace("\n", " # f 1 2 3\n"),
        "groups": obj().replace("f 6", "g a b\nusemtl steel\ns 1\nf 6"),
        "colours": obj().replace("v 0 0 0", "v 0 0 0 0.5 0.5 0.5"),
    }[kind]


@pytest.mark.parametrize(
    "kind", ["negative", "textures", "normals", "both, CRLF", "continued", "comments", "groups", "colours"]
)
def test_obj_of_many_ways(kind: str, tmp_path: Path) -> None:
    (tmp_path / "part.obj").write_bytes(obj_of(kind).encode())
    checked = read_checked_here(tmp_path / "part.obj", "mm")
    assert as_trimesh(checked).volume * 1e9 == pytest.approx(12_000) and not checked.notes


WHOLE: dict[str, tuple[str, bytes, float, str]] = {
    "negative indices of two bodies": ("a.obj", two_boxes().encode(), 26_500, "joined 2 bodies"),
    "concave faces, ASCII PLY": ("a.ply", ply("ascii"), 12_000, ""),
    "concave faces, little-endian PLY": ("a.ply", ply("binary_little_endian"), 12_000, ""),
    "concave faces, big-endian PLY": ("a.ply", ply("binary_big_endian"), 12_000, ""),
    "binary STL that begins with solid": ("a.stl", stl(head=b"solid facet of a part"), 24_000, ""),
    "padding after an STL": ("a.stl", stl(rest=bytes(10)), 24_000, "passed over 10 bytes"),
    "ASCII STL whose name is of words of the format": ("a.stl", stl_text("vertex facet 3").encode(), 24_000, ""),
    "ASCII STL of two solids": ("a.stl", (stl_text() + "solid\nendsolid\n").upper().encode(), 24_000, ""),
}


@pytest.mark.parametrize("kind", WHOLE)
def test_whole_files(kind: str, tmp_path: Path) -> None:
    name, data, volume, note = WHOLE[kind]
    (tmp_path / name).write_bytes(data)
    checked = read_checked_here(tmp_path / name, "mm")
    assert as_trimesh(checked).volume * 1e9 == pytest.approx(volume, rel=1e-5)
    assert note in "; ".join(checked.notes) and bool(note) == bool(checked.notes)


def glb(change: Callable[[bytes], bytes] = lambda data: data) -> bytes:
    return change(bytes(BOX.export(file_type="glb")))


BROKEN: dict[str, tuple[str, bytes, str]] = {
    "cut binary STL": ("a.stl", stl()[:-200], "8 of 12 declared triangles: the file was cut short"),
    "cut in a triangle": ("a.stl", stl()[:-201], "7 of 12 declared triangles"),
    "cut, begins with solid": ("a.stl", stl(head=b"solid part")[:-201], "7 of 12 declared triangles"),
    "cut in a binary header": ("a.stl", stl(head=b"part\1")[:70], "70 bytes, less than the header"),
    "cut in the header": ("a.stl", stl(head=b"solid part")[:70], "no endsolid"),
    "count too small": ("a.stl", stl(count=10), "100 bytes after the 10 declared triangles, room for 2 more"),
    "count of nought": ("a.stl", stl(count=0), "600 bytes after the 0 declared triangles, room for 12 more"),
    "bytes after an STL": ("a.stl", stl(rest=b"more"), "4 bytes after the 12 declared triangles"),
    "no faces": ("a.stl", stl(count=0, head=b"part")[:84], "no faces: 0 declared triangles"),
    "no endsolid": ("a.stl", stl_text().replace("endsolid", "").encode(), "12 whole facets and no endsolid"),
    "cut in a facet": ("a.stl", stl_text().encode()[:-60], "11 whole facets, and one that is broken"),
    "facet of two vertices": ("a.stl", stl_text().replace("vertex", "edge", 1).encode(), "11 whole facets"),
    "STL facets of NaN": ("a.stl", stl_text().replace("20.0", "nan").encode(), "coordinates that are no numbers"),
    "words for numbers": ("a.stl", stl_text().replace("20.0", "ten").encode(), "are no numbers"),
    "cut PLY": ("a.ply", ply("binary_little_endian")[:-3], "7 of 8 declared faces: the file was cut short"),
    "cut big-endian PLY": ("a.ply", ply("binary_big_endian")[:-18], "6 of 8 declared faces"),
    "cut in vertices": ("a.ply", ply("binary_little_endian")[:300], "of 12 declared vertices"),
    "cut ASCII PLY": ("a.ply", ply("ascii")[:-8], "7 of 8 declared faces: the file was cut short"),
    "more faces declared": ("a.ply", ply("ascii", declared=(12, 10)), "8 of 10 declared faces"),
    "fewer faces declared": ("a.ply", ply("ascii", declared=(12, 7)), "1 lines after the declared rows"),
    "fewer in binary": ("a.ply", ply("binary_little_endian", declared=(12, 7)), "17 bytes after the declared faces"),
    "more vertices declared": ("a.ply", ply("ascii", declared=(13, 8)), "row 13 of 13 vertices"),
    "PLY index beyond": ("a.ply", ply("ascii", [*FACES[:7], [5, 0, 6, 12]]), "face 8 with vertex 12 (counted from 0)"),
    "PLY without an end of its header": ("a.ply", ply("ascii")[:60], "end_header"),
    "OBJ index beyond": ("a.obj", obj().replace("f 6 5", "f 40 5").encode(), "vertex 40 of 12 in line 13"),
    "OBJ index before": ("a.obj", obj(lambda i: str(i - 13)).encode(), "corner `-13` in line 13, after 12 vertices"),
    "OBJ index of nought": ("a.obj", obj(str).encode(), "corner `0` in line 13"),
    "OBJ face of two corners": ("a.obj", (obj() + "f 1 2\n").encode(), "a face of 2 corners in line 21"),
    "OBJ without numbers": ("a.obj", obj().replace("v 40 0 0", "v 40 0").encode(), "`v 40 0` in line 2"),
    "cut OBJ": ("a.obj", two_boxes().encode()[:460], "vertices that no face uses: the file was cut short"),
    "cut at an object": ("a.obj", (obj() + "o second\n").encode(), "`o second` at the end without faces"),
    "free-form surface": ("a.obj", (obj() + "surf 0 1 0 1 1 2 3\n").encode(), "a surface without faces"),
    "cut GLB": ("a.glb", glb(lambda d: d[:-40]), "declared bytes: the file was cut short"),
    "GLB that asks for more": ("a.glb", glb(lambda d: d.replace(b'"count":36', b'"count":96')), "96 declared items"),
    "GLB that asks for less": ("a.glb", glb(lambda d: d.replace(b'"count":36', b'"count":35')), ""),
    "GLB of fans": ("a.glb", glb(lambda d: d.replace(b'"mode":4', b'"mode":6')), "triangle fans"),
    "cut STEP": ("a.step", step_box((40, 30, 20)).encode()[:-400], "no END-ISO-10303-21; at the end"),
    "empty OBJ": ("a.obj", b"", "no faces: 0 vertices"),
    "empty PLY": ("a.ply", b"", "no header"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BROKEN)
def test_broken_files_are_refused_with_what_is_wrong(kind: str, tmp_path: Path) -> None:
    if kind == "cut STEP":
        pytest.importorskip("cascadio")
    name, data, words = BROKEN[kind]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError) as error:
        read_checked_here(tmp_path / name, "mm")
    assert name in str(error.value) and words in str(error.value) and "\n" not in str(error.value)


@pytest.mark.slow
def test_the_process_says_the_same(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(stl()[:-200])
    with pytest.raises(InputError, match="8 of 12 declared triangles"):
        read_checked(tmp_path / "a.stl", "mm")
    (tmp_path / "b.stl").write_bytes(stl(rest=bytes(10)))
    assert read_checked(tmp_path / "b.stl", "mm").notes == ["passed over 10 bytes of padding at the end"]


OUTLINES = {
    "convex": [(0, 0), (4, 0), (5, 3), (2, 5), (-1, 3)],
    "concave at the first corner": [(1, 1), (4, 0), (4, 4), (0, 4), (0, 3)],
    "straight corners": [(0, 0), (1, 0), (2, 0), (2, 2), (0, 2)],
    "bridge to a hole": [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)],
    "comb": [(0, 0), (7, 0), (7, 5), (6, 5), (6, 1), (5, 1), (5, 5), (4, 5), (4, 1), (3, 1), (3, 5), (0, 5)],
}


@pytest.mark.parametrize("kind", OUTLINES)
@pytest.mark.parametrize("turned", [False, True])
def test_triangles_cover_a_polygon_once_and_keep_its_winding(kind: str, turned: bool) -> None:
    flat = np.array(OUTLINES[kind][:: -1 if turned else 1], dtype=float)
    T = trimesh.transformations.euler_matrix(0.4, -1.1, 2.0)
    points = trimesh.transform_points(np.column_stack([flat, np.zeros(len(flat))]), T)
    faces = triangulate(points, np.arange(len(flat)), np.array([len(flat)]))
    a, b, c = (points[faces[:, k]] for k in range(3))
    along = np.cross(b - a, c - a) @ T[:3, 2] / 2
    x, y = flat.T
    area = float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)
    assert len(faces) == len(flat) - 2 and along.sum() == pytest.approx(area)
    assert (along * np.sign(area) > -1e-9).all()


def test_a_crossed_outline_is_refused() -> None:
    star = np.array([(np.cos(t), np.sin(t), 0) for t in 2 * np.pi * np.arange(5) * 2 / 5])
    with pytest.raises(MeshError, match="outline crosses itself"):
        triangulate(star, np.arange(5), np.array([5]))


def test_polygons_keep_their_order() -> None:
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float)
    faces = triangulate(square, np.array([0, 1, 2, 3, 2, 1, 0, 0, 3, 2]), np.array([4, 3, 3]))
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [2, 1, 0], [0, 3, 2]]


def test_a_hit_that_the_ray_caster_missed_refuses_no_good_part(monkeypatch: pytest.MonkeyPatch) -> None:
    """Embree misses a hit in some thousands near edges; rays after it must not start inside."""
    cast = type(BOX.ray).intersects_location

    def missing(self: object, *args: object, **options: object) -> tuple[np.ndarray, ...]:
        hits, ray, face = cast(self, *args, **options)
        lost = np.arange(len(ray)) != np.argmin(ray)
        return hits[lost], ray[lost], face[lost]

    monkeypatch.setattr(type(BOX.ray), "intersects_location", missing)
    check_crossing(np.asarray(BOX.vertices), np.asarray(BOX.faces))


@pytest.mark.parametrize(
    ("longest", "unit", "found", "likely"),
    [
        (3000, "m", "3000 m long", "--unit mm it would be 3 m long"),
        (1500, "m", "1500 m long", "--unit mm it would be 1500 mm long"),
        (0.003, "mm", "0.003 mm long", "--unit m it would be 3 mm long"),
        (30_000, "mm", "30 m long", "--unit um it would be 30 mm long"),
        (3e-6, "m", "0.003 mm long", "a part of 3 mm to 2 m"),
    ],
)
def test_absurd_lengths_name_the_unit_that_is_likely(longest: float, unit: str, found: str, likely: str) -> None:
    with pytest.raises(MeshError) as fault:
        check_size(longest, unit)
    assert found in fault.value.found and fault.value.valid.endswith(likely)
