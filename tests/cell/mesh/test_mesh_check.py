"""Meshes as users have them: each is repaired, and said how, or refused in one line."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import manifold3d as m3
import numpy as np
import pytest
import trimesh

from pickproof.cell.errors import InputError
from pickproof.cell.mesh.check import check_mesh, check_size
from pickproof.cell.mesh.checked import as_trimesh
from pickproof.cell.mesh.crossing import look_for_crossing
from pickproof.cell.mesh.error import MeshError
from pickproof.cell.mesh.read import read_checked
from tests.cell.mesh.step_box import step_box

pytestmark = pytest.mark.slow

BOX = trimesh.creation.box((40, 30, 20))


def sphere() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=4, radius=20)


def soup(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """As an STL gives it: three corners for each face."""
    return mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3)


def without(mesh: trimesh.Trimesh, gone: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces[~gone], process=False)


def beside(*moves: tuple[float, float, float]) -> trimesh.Trimesh:
    return trimesh.util.concatenate([BOX.copy().apply_translation(move) for move in ((0, 0, 0), *moves)])


def mixed() -> trimesh.Trimesh:
    ring = trimesh.creation.torus(20, 5)
    turned = np.random.default_rng(0).random(len(ring.faces)) < 0.4
    ring.faces[turned] = ring.faces[turned][:, ::-1]
    return ring


def hollow() -> trimesh.Trimesh:
    inner = trimesh.creation.box((10, 10, 10))
    inner.invert()
    return trimesh.util.concatenate([BOX, inner])


def inverted() -> trimesh.Trimesh:
    box = hollow()
    box.invert()
    return box


def seam() -> trimesh.Trimesh:
    """A box whose one face is off by a thousandth of a millimetre, as from a careless exporter."""
    corners, faces = soup(BOX)
    corners = corners.copy()
    corners[:3] += 0.001
    return trimesh.Trimesh(corners, faces, process=False)


def twice() -> trimesh.Trimesh:
    return trimesh.Trimesh(BOX.vertices, np.concatenate([BOX.faces, BOX.faces[:3]]), process=False)


def waves(mesh: trimesh.Trimesh) -> np.ndarray:
    return 5 * np.sin(mesh.triangles_center[:, 0] / 4)


def crossing() -> trimesh.Trimesh:
    fine = BOX.subdivide().subdivide()
    top = np.argmin(np.linalg.norm(fine.vertices - [0, 0, 10], axis=1))
    fine.vertices[top] = (0, 0, -45)
    return fine


SHEET = trimesh.Trimesh([[-9, -9, -3], [9, -9, -3], [0, 9, 3]], [[0, 1, 2]], process=False)


def crumb(i: int) -> trimesh.Trimesh:
    return trimesh.creation.box((4, 4, 4)).apply_translation((6 * i, 50, 0))


def small_hole() -> trimesh.Trimesh:
    hole = trimesh.creation.box((1, 1, 1))
    hole.invert()
    return hole


def turned_bump() -> trimesh.Trimesh:
    bump = trimesh.creation.box((10, 10, 10)).apply_translation((3, 2, 12))
    bump.invert()
    return bump


def pinched() -> trimesh.Trimesh:
    """A cube and the arms of an angle about it: a corner of the cube meets one of the angle along an edge."""
    angle = [((20, 60, 20), (-20, 20, 0)), ((60, 20, 20), (0, 40, 0))]
    bars = [((20, 20, 20), (0, 0, 0)), ((20, 20, 20), (20, 20, 0)), *angle]
    whole = m3.Manifold()
    for size, at in bars:
        whole += m3.Manifold.cube(size, True).translate(at)
    made = whole.to_mesh64()
    return trimesh.Trimesh(made.vert_properties[:, :3], np.array(made.tri_verts), process=False)


def fin() -> trimesh.Trimesh:
    a, b, _ = BOX.faces[0]
    return trimesh.Trimesh(np.vstack([BOX.vertices, [0, 0, 60]]), np.vstack([BOX.faces, [a, b, 8]]), process=False)


def crossed_ring() -> trimesh.Trimesh:
    """A tube that runs round twice and through itself, as one surface."""
    turns, round_ = 120, 24
    t, s = np.meshgrid(np.arange(turns) * 4 * np.pi / turns, np.arange(round_) * 2 * np.pi / round_, indexing="ij")
    r, z = 20 + 3 * np.cos(t / 2) + 4 * np.cos(s), 4 * np.sin(s)
    points = np.stack([r * np.cos(t), r * np.sin(t), z], -1).reshape(-1, 3)
    i, j = (k.ravel() for k in np.meshgrid(np.arange(turns), np.arange(round_), indexing="ij"))
    at = [((i + di) % turns) * round_ + (j + dj) % round_ for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1))]
    faces = np.concatenate([np.stack([at[0], at[1], at[2]], 1), np.stack([at[0], at[2], at[3]], 1)])
    return trimesh.Trimesh(points, faces, process=False)


REPAIRED: dict[str, tuple[Callable[[], trimesh.Trimesh], float, str]] = {
    "good": (lambda: BOX, 24000, ""),
    "inside out": (inverted, 23000, "turned inside out"),
    "missing face": (lambda: without(BOX, np.arange(12) == 11), 24000, "closed 1 holes, the widest of 30 mm"),
    "flat cut": (lambda: without(sphere(), sphere().triangles_center[:, 2] > 5), 23360, "closed 1 holes"),
    "small uneven hole": (
        lambda: without(sphere(), np.linalg.norm(sphere().triangles_center - [0, 0, 20], axis=1) < 1.5), 33430, "closed"
    ),
    "faces of both ways": (mixed, 9743, "looked the other way"),
    "face there twice": (twice, 24000, "removed 3 faces that were there twice"),
    "seam": (seam, 24000, "welded"),
    "overlapping bodies": (lambda: beside((20, 7, 5)), 41100, "joined 2 bodies"),
    "cavity": (hollow, 23000, "kept 1 closed cavities"),
    "touching bodies": (lambda: beside((0, 0, 20)), 48000, "joined 2 bodies"),
    "touching bodies that share a part of a face": (lambda: beside((20, 15, 20)), 48000, "joined 2 bodies"),
    "cavity of a cubic millimetre": (lambda: trimesh.util.concatenate([BOX, small_hole()]), 23999, "kept 1 closed"),
    "one body of two inside out": (lambda: trimesh.util.concatenate([BOX, turned_bump()]), 24700, "turned 1 bodies"),
    "touching itself along an edge": (pinched, 56000, "touches itself along 1 edges, one at (10.0, 10.0, 0.0) mm"),
    "fin": (fin, 24000, "left out 1 loose faces of 808 mm2"),
    "sheet inside": (lambda: trimesh.util.concatenate([BOX, SHEET]), 24000, "left out 1 loose faces"),
    "two rings in one surface": (crossed_ring, 9770, "made the surface anew from its distance field"),
    "crumb": (lambda: trimesh.util.concatenate([BOX, trimesh.creation.box((1, 1, 1)).apply_translation((50, 0, 0))]),
              24000, "left out 1 bodies"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REPAIRED)
def test_repairs(kind: str) -> None:
    make, volume, words = REPAIRED[kind]
    checked = check_mesh(*soup(make()), "mm")
    mesh = as_trimesh(checked)
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.volume * 1e9 == pytest.approx(volume, rel=2e-3)
    assert words in "; ".join(checked.notes) and bool(words) == bool(checked.notes)


def test_faces_without_numbers_are_left_out() -> None:
    corners, faces = soup(sphere())
    corners = corners.copy()
    corners[30:33] = np.nan
    checked = check_mesh(corners, faces, "mm")
    assert "1 faces with coordinates that are no numbers" in checked.notes[0] and as_trimesh(checked).is_watertight


@pytest.mark.slow
def test_many_faces_become_few_and_stay_near() -> None:
    fine = trimesh.creation.icosphere(subdivisions=7, radius=30)
    checked = check_mesh(*soup(fine), "mm")
    assert len(fine.faces) > 300_000 and len(checked.faces) <= 20_000
    radii = np.linalg.norm(checked.vertices, axis=1)
    assert np.abs(radii - 0.03).max() < 1e-4 and "the surface moved by" in checked.notes[-1]


REFUSED: dict[str, tuple[Callable[[], trimesh.Trimesh], str]] = {
    "two bodies": (lambda: beside((100, 0, 0)), "2 bodies that do not touch"),
    "touching along an edge only": (lambda: beside((40, 0, 20)), "2 bodies that do not touch, or at an edge only"),
    "many small bodies apart": (
        lambda: trimesh.util.concatenate([BOX, *(crumb(i) for i in range(30))]), "30 small bodies that do not touch"
    ),
    "open shell": (
        lambda: without(sphere(), sphere().triangles_center[:, 2] + waves(sphere()) > 5),
        "a hole of 39.7 mm at (0.4, -0.0, 4.9) mm whose rim is not flat",
    ),
    "passes through itself": (crossing, "passes through itself"),
    "sheet without thickness": (lambda: trimesh.Trimesh([[0, 0, 0], [40, 0, 0], [0, 30, 0]], [[0, 1, 2], [0, 2, 1]],
                                                        process=False), ""),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_refusals(kind: str) -> None:
    make, words = REFUSED[kind]
    with pytest.raises(MeshError) as fault:
        check_mesh(*soup(make()), "mm")
    assert words in fault.value.found and fault.value.valid


def test_bodies_apart_are_offered_one_by_one() -> None:
    """The largest first, each with its size in the file's unit and its place."""
    loose = beside((100, 0, 0))
    loose.vertices[8:] *= (1.0, 0.5, 0.5)
    with pytest.raises(MeshError) as fault:
        check_mesh(*soup(loose), "mm")
    listed = "1: 40 x 30 x 20 mm at (0.0, 0.0, 0.0) mm, 24 cm3; 2: 40 x 15 x 10 mm at (100.0, 0.0, 0.0) mm, 6 cm3"
    assert listed in fault.value.found and "--body N" in fault.value.valid
    second = check_mesh(*soup(loose), "mm", body=2)
    assert as_trimesh(second).volume == pytest.approx(6e-6) and "took body 2 of 2" in second.notes[-1]
    with pytest.raises(MeshError, match="--body 3"):
        check_mesh(*soup(loose), "mm", body=3)


def test_a_surface_made_anew_says_how_far_it_is_off() -> None:
    made = check_mesh(*soup(crossed_ring()), "mm")
    assert 0 < made.moved < 2e-4 and 0 < made.volume_change < 0.01
    assert look_for_crossing(made.vertices, made.faces).doubled == 0


@pytest.mark.parametrize(
    ("longest", "unit", "likely"),
    [
        (56, "m", "--unit mm"),
        (0.056, "mm", "--unit m "),
        (0.05, "mm", "--unit m "),
        (2.2, "mm", "cm"),
        (9000, "mm", ""),
    ],
)
def test_a_wrong_unit_is_named(longest: float, unit: str, likely: str) -> None:
    with pytest.raises(MeshError) as fault:
        check_size(longest, unit)
    assert f"--unit {unit}" in fault.value.found and likely in fault.value.valid


def glb_bomb(path: Path) -> None:
    """A glTF of half a kilobyte with 300 million points of nought."""
    n = 300_000_000
    accessors = [
        {"count": n, "componentType": 5126, "type": "VEC3"},
        {"count": 3 * n, "componentType": 5125, "type": "SCALAR"},
    ]
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}], "accessors": accessors,
        "buffers": [{"byteLength": 4}], "bufferViews": [],
    }  # fmt: skip
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<III", 0x46546C67, 2, 32 + len(text))
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", 4, 0x004E4942) + bytes(4)
    path.write_bytes(head + chunks)


def ply_bomb(path: Path) -> None:
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 300000000\nproperty float x\nproperty float y\n"
    head += "property float z\nelement face 300000000\nproperty list uchar int vertex_indices\nend_header\n"
    path.write_bytes(head.encode() + bytes(1000))


FILES: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "text": ("part.stl", lambda p: p.write_text("no mesh at all\n" * 30), ""),
    "empty": ("part.stl", lambda p: p.write_bytes(b""), "no faces"),
    "random": ("part.glb", lambda p: p.write_bytes(np.random.default_rng(0).bytes(4000)), ""),
    "archive": ("part.zip", lambda p: p.write_bytes(b"PK"), "archives are to be unpacked"),
    "3mf": ("part.3mf", lambda p: p.write_bytes(b"PK"), "archives are to be unpacked"),
    "glb bomb": ("part.glb", glb_bomb, "more than 2 GiB"),
    "ply bomb": ("part.ply", ply_bomb, ""),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", FILES)
def test_bad_files_are_one_line(kind: str, tmp_path: Path) -> None:
    name, write, words = FILES[kind]
    write(tmp_path / name)
    with pytest.raises(InputError) as error:
        read_checked(tmp_path / name, "mm")
    assert name in str(error.value) and words in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "glb"])
def test_formats(kind: str, tmp_path: Path) -> None:
    BOX.export(tmp_path / f"part.{kind}")
    checked = read_checked(tmp_path / f"part.{kind}", "mm")
    assert np.ptp(checked.vertices, axis=0) == pytest.approx([0.04, 0.03, 0.02]) and not checked.notes


@pytest.mark.slow
@pytest.mark.parametrize(("prefix", "scale"), [(".MILLI.", 1.0), ("$", 1e-3)])
def test_step_tells_its_own_unit(prefix: str, scale: float, tmp_path: Path) -> None:
    pytest.importorskip("cascadio")
    (tmp_path / "part.step").write_text(step_box((40 * scale, 30 * scale, 20 * scale), prefix))
    checked = read_checked(tmp_path / "part.step", "mm")
    assert np.ptp(checked.vertices, axis=0) == pytest.approx([0.04, 0.03, 0.02], rel=1e-5)
    assert as_trimesh(checked).volume == pytest.approx(24e-6, rel=1e-5)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="missing file"):
        read_checked(tmp_path / "none.stl", "mm")
