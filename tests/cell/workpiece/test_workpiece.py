"""Workpieces: what the shipped one is, and what a bad one is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from pickproof.cell.errors import InputError
from pickproof.cell.workpiece.workpiece import Workpiece, list_workpieces, load_workpiece
from tests.cell.workpiece.block import write_block


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PICKPROOF_WORKPIECES", str(tmp_path))
    return tmp_path


def refused(folder: Path, **changes: object) -> InputError:
    write_block(folder, **changes)
    with pytest.raises(InputError) as caught:
        load_workpiece("block")
    assert caught.value.file.endswith("workpiece.yaml")
    return caught.value


def test_mass_and_inertia_of_a_box_are_those_of_the_textbook(folder: Path) -> None:
    write_block(folder)
    block = load_workpiece("block")
    mass = 7850 * 0.04 * 0.03 * 0.02
    assert block.mass == pytest.approx(mass)
    np.testing.assert_allclose(block.com, 0.0, atol=1e-9)
    x, y, z = 0.04**2, 0.03**2, 0.02**2
    np.testing.assert_allclose(block.inertia, mass / 12 * np.diag([y + z, x + z, x + y]), rtol=1e-6, atol=1e-12)


def test_units_are_converted_at_the_door(folder: Path) -> None:
    write_block(folder, mesh=trimesh.creation.box(extents=(40.0, 30.0, 20.0)), mesh_unit="mm")
    np.testing.assert_allclose(load_workpiece("block").extents, [0.04, 0.03, 0.02], rtol=1e-6)


def test_collision_boxes_of_the_bracket_fill_its_solid(bracket: Workpiece) -> None:
    low = np.min([np.subtract(b.centre, np.divide(b.size, 2)) for b in bracket.collision_boxes], axis=0)
    high = np.max([np.add(b.centre, np.divide(b.size, 2)) for b in bracket.collision_boxes], axis=0)
    np.testing.assert_allclose([low, high], bracket.mesh.bounds, atol=1e-6)
    points = np.random.default_rng(0).uniform(low, high, (4000, 3))
    inside_boxes = np.zeros(len(points), dtype=bool)
    for b in bracket.collision_boxes:
        inside_boxes |= (np.abs(points - b.centre) < np.divide(b.size, 2)).all(axis=1)
    volume = inside_boxes.mean() * np.prod(high - low)
    assert volume == pytest.approx(bracket.mesh.volume, rel=0.08)  # they leave the hole out


def test_the_mesh_is_read_only(bracket: Workpiece) -> None:
    with pytest.raises(ValueError, match="read-only"):
        bracket.vertices[0] = 0.0


def test_an_unknown_workpiece_is_told_the_known_ones() -> None:
    with pytest.raises(InputError) as caught:
        load_workpiece("brackett")
    assert caught.value.field == "workpiece" and "bracket" in caught.value.valid
    assert "bracket" in list_workpieces()


def test_a_missing_mesh_is_named(folder: Path) -> None:
    path = write_block(folder)
    (path.parent / "block.stl").unlink()
    with pytest.raises(InputError, match=r"workpiece\.yaml: mesh: .*block\.stl") as caught:
        load_workpiece("block")
    assert caught.value.field == "mesh"


def test_an_open_mesh_is_refused(folder: Path) -> None:
    mesh = trimesh.creation.box(extents=(0.04, 0.03, 0.02))
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    assert "watertight" in refused(folder, mesh=mesh).valid


def test_a_mesh_that_is_no_mesh_is_refused(folder: Path) -> None:
    path = write_block(folder)
    (path.parent / "block.stl").write_text("this is not a mesh")
    with pytest.raises(InputError) as caught:
        load_workpiece("block")
    assert caught.value.field == "mesh"


def test_a_mesh_cut_short_is_refused_with_its_counts(folder: Path) -> None:
    path = write_block(folder)
    mesh = path.parent / "block.stl"
    mesh.write_bytes(mesh.read_bytes()[:-200])
    with pytest.raises(InputError, match=r"mesh: 'block\.stl: 8 of 12 declared triangles: the file was cut short'"):
        load_workpiece("block")


def test_bodies_that_overlap_are_refused(folder: Path) -> None:
    """Their volumes would be added, and mass with them."""
    bodies = [trimesh.creation.box(extents=extents) for extents in ((0.04, 0.03, 0.02), (0.02, 0.02, 0.01))]
    assert "passes through itself" in str(refused(folder, mesh=trimesh.util.concatenate(bodies)).value)


def test_a_size_that_no_part_has_names_the_unit(folder: Path) -> None:
    mesh = trimesh.creation.box(extents=(40.0, 30.0, 20.0))
    error = refused(folder, mesh=mesh, mesh_unit="m")
    assert error.field == "mesh_unit" and "in mm it would be 40 mm long" in error.valid


@pytest.mark.parametrize(
    ("field", "changes"),
    [
        ("densty", {"densty": 7850}),
        ("density", {"density": -1}),
        ("density", {"density": float("nan")}),
        ("density", {"density": None}),
        ("friction", {"friction": "rough"}),
        ("mesh_unit", {"mesh_unit": "inch"}),
        ("mesh_unit", {"mesh_unit": "mm"}),  # 40 micrometres across
        ("collision_boxes", {"collision_boxes": []}),
        ("collision_boxes.0.size", {"collision_boxes": [{"size": [1, 2], "centre": [0, 0, 0]}]}),
        ("symmetry.degrees", {"symmetry": {"degrees": [50, 70, 0]}}),
    ],
)
def test_a_bad_field_is_named(folder: Path, field: str, changes: dict[str, object]) -> None:
    assert refused(folder, **changes).field.startswith(field)


def test_a_mesh_off_its_frame_is_refused(folder: Path) -> None:
    mesh = trimesh.creation.box(extents=(0.04, 0.03, 0.02))
    mesh.apply_translation((0.01, 0, 0))
    error = refused(folder, mesh=mesh)
    assert error.field == "mesh" and "0.01" in str(error)


def test_a_syntax_error_is_placed(folder: Path) -> None:
    path = write_block(folder)
    path.write_text("name: block\nmesh: [\n")
    with pytest.raises(InputError, match="line 3"):
        load_workpiece("block")
