"""`pickproof onboard` from a plain STL to a folder that the other commands take."""

from __future__ import annotations

import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pickproof.cell.child_process import FOLDERS
from pickproof.cell.errors import InputError
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.mesh.checked import Checked
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.resting_poses import resting_poses
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.grasp_points import load_grasps
from pickproof.scenarios.commands.cli import main
from pickproof.scenarios.commands.workpiece.onboard import OnboardOptions, decided
from pickproof.scenarios.config.scenario import Scenario, load_scenario
from pickproof.scenarios.onboarding import part as onboard_part
from pickproof.scenarios.onboarding.cell_proposal import propose_cell, propose_heap, rank_grippers
from pickproof.scenarios.onboarding.part import search_symmetry, understand, write_workpiece
from pickproof.scenarios.picking.workcell import check_inputs
from tests.cell.workpiece.part_shapes import extruded, mesh_of, polygon

pytestmark = pytest.mark.slow

ORACLE = frozenset({"perception"})
OPTIONS = OnboardOptions(unit="mm", name="x")


@pytest.fixture(scope="module")
def onboarded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    """The folder of workpieces with a bar of 50 x 24 x 14 mm as `bar`, and the exit code."""
    root = tmp_path_factory.mktemp("parts")
    trimesh.creation.box((50, 24, 14)).apply_translation((100, 7, -3)).export(root / "bar.stl")
    words = ["onboard", str(root / "bar.stl"), "--unit", "mm", "--name", "bar", "--yes", "--workpieces", str(root)]
    with pytest.MonkeyPatch.context() as patch:  # a few grasps say as much of the files as many
        patch.setattr("pickproof.scenarios.onboarding.part.PROPOSED", 4)
        patch.setattr("pickproof.scenarios.onboarding.part.ENOUGH", 3)
        return root, main(words)


def test_it_writes_all_that_the_other_commands_need(onboarded, monkeypatch) -> None:
    root, code = onboarded
    assert code == 0
    assert {p.name for p in (root / "bar").iterdir()} >= {
        "workpiece.yaml", "bar.ply", "grasps.yaml", "scenario.yaml", "onboard.html", "onboard.json"
    }  # fmt: skip
    assert sorted(p.name for p in root.iterdir()) == ["bar", "bar.stl"]  # no draft is left behind
    monkeypatch.setenv(FOLDERS, str(root))
    workpiece, scenario = load_workpiece("bar"), load_scenario("bar")
    assert workpiece.symmetry.degrees == (180, 180, 180)
    assert workpiece.mass == pytest.approx(7850 * 0.05 * 0.024 * 0.014, rel=1e-4)
    assert workpiece.extents == pytest.approx([0.05, 0.024, 0.014], abs=1e-7)
    check_inputs(scenario, ORACLE)
    points = load_grasps(workpiece, load_gripper(scenario.gripper)).points
    assert points and all(point.robustness > 0.5 for point in points)


def test_the_page_stands_alone(onboarded) -> None:
    text = (onboarded[0] / "bar" / "onboard.html").read_text()
    assert text.count("data:image/png;base64,") == 4 and not re.search(r"(src|href)=\"(?!data:)", text)
    assert "180 deg about x" in text and "workpiece: bar" in text
    told = json.loads((onboarded[0] / "bar" / "onboard.json").read_text())
    T = np.array(told["T_part_cad"])
    assert pytest.approx([0, 0, 0, 1], abs=1e-6) == T @ [0.1, 0.007, -0.003, 1]
    assert sum(pose["probability"] for pose in told["resting"]) == pytest.approx(1.0, abs=0.05)


def test_it_says_what_is_found_without_training(onboarded) -> None:
    root, _ = onboarded
    found = json.loads((root / "bar" / "onboard.json").read_text())["search"]
    assert found["heaps"] == 8
    assert found["instances"] > 20
    assert found["f1_inst"] > 90 and found["precision"] > 90
    assert found["worth_training"] == (found["f1_inst"] < 97)
    assert f"F1 {found['f1_inst']:.1f} %" in (root / "bar" / "onboard.html").read_text()


def test_what_was_onboarded_runs_without_weights(onboarded, monkeypatch) -> None:
    monkeypatch.setenv(FOLDERS, str(onboarded[0]))
    check_inputs(load_scenario("bar"), frozenset())
    with pytest.raises(InputError):
        check_inputs(load_scenario("bar", ["perception.method=ps6d"]), frozenset())


def test_a_name_that_is_taken_is_refused(onboarded, capsys) -> None:
    root, _ = onboarded
    words = ["onboard", str(root / "bar.stl"), "--unit", "mm", "--name", "bar", "--yes", "--workpieces", str(root)]
    assert main(words) == 2
    assert "--replace" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["--unit", "m", "--name", "bar2", "--yes"], ["50 m long", "--unit mm"]),
        (["--unit", "mm", "--name", "a b", "--yes"], ["--name", "letters"]),
        (["--unit", "mm", "--name", "bar2", "--symmetry", "0", "0", "400"], ["--symmetry", "400"]),
        (["--unit", "mm", "--name", "bar2", "--symmetry", "0", "50", "70"], ["--symmetry", "finite rotation group"]),
        (["--unit", "furlong", "--name", "bar2"], ["--unit", "furlong"]),
        (["--unit", "mm", "--name", "bar2", "--yes", "--workpieces", "{root}/bar.stl"], ["--workpieces", "bar.stl"]),
    ],
)
def test_bad_arguments_are_one_line(onboarded, words, names, capsys) -> None:
    root, _ = onboarded
    words = [word.format(root=root) for word in words]
    if "--workpieces" not in words:
        words += ["--workpieces", str(root)]
    assert main(["onboard", str(root / "bar.stl"), *words]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and all(name in err for name in names)
    assert not (root / "bar2").exists()


def test_a_mesh_cut_short_is_one_line(tmp_path, capsys) -> None:
    path = tmp_path / "bar.stl"
    path.write_bytes(trimesh.creation.box((50, 24, 14)).export(file_type="stl")[:-200])
    assert main(["onboard", str(path), "--unit", "mm", "--name", "bar", "--workpieces", str(tmp_path)]) == 2
    err = capsys.readouterr().err
    assert (
        err.count("\n") == 1 and "bar.stl" in err and "8 of 12 declared triangles" in err and "export it again" in err
    )


@pytest.mark.parametrize(("answer", "degrees"), [("", (0, 0, 120)), ("0 0 0", (0, 0, 0)), ("y", (0, 0, 120))])
def test_the_user_decides(answer, degrees, monkeypatch) -> None:
    _, found = search_symmetry(checked_frustum())
    monkeypatch.setattr("builtins.input", lambda prompt: answer)
    assert decided(OPTIONS, found) == degrees


def test_without_an_answer_it_asks_for_yes(monkeypatch) -> None:
    def closed(prompt: str) -> str:
        raise EOFError

    monkeypatch.setattr("builtins.input", closed)
    with pytest.raises(InputError, match="--yes"):
        decided(OPTIONS, search_symmetry(checked_frustum())[1])


def checked_frustum() -> Checked:
    mesh = mesh_of(extruded(polygon(3, 30), 40, top=0.6))
    return Checked(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def test_an_axis_of_odd_order_goes_through_the_origin(tmp_path, monkeypatch) -> None:
    """The centre of a triangle's bounding box is not on its axis; the loader takes the axis."""
    checked = checked_frustum()
    mesh, found = search_symmetry(checked)
    part = understand("wedge", "pom", checked, mesh, found, found.degrees)
    write_workpiece(part, tmp_path / "wedge")
    monkeypatch.setenv(FOLDERS, str(tmp_path))
    workpiece = load_workpiece("wedge")
    assert workpiece.symmetry.degrees == (0, 0, 120)
    assert workpiece.com[:2] == pytest.approx([0, 0], abs=1e-6)
    low, high = workpiece.vertices.min(axis=0), workpiece.vertices.max(axis=0)
    assert abs(low[2] + high[2]) < 1e-6 and np.abs(low[:2] + high[:2]).max() > 0.01
    # the upper and the lower face, and three sides that count as one
    poses = resting_poses(workpiece.mesh, workpiece.symmetry)
    assert 2 <= len(poses) <= 3 and sum(p.probability for p in poses) == pytest.approx(1.0, abs=0.05)


def test_a_rolling_cylinder_rests_in_two_ways() -> None:
    bar = trimesh.creation.cylinder(0.01, 0.05, sections=64)
    poses = resting_poses(bar, Symmetry((180, 180, 5)))
    assert len(poses) == 2
    lying = poses[0].T_plane_part
    assert abs(lying[2, 2]) < 1e-6 and poses[0].probability > 0.6


@pytest.mark.parametrize("name", ["bracket", "candlestick", "gear_shaft", "ps6d_24", "tless_20", "bunny"])
def test_a_cell_is_proposed_for_shipped_parts(name) -> None:
    """For each a gripper that may hold it, and a scenario that its own checks accept, near the shipped one."""
    workpiece = load_workpiece(name)
    heap = propose_heap(workpiece.extents)
    shipped = np.array(workpiece.heap.bin_inner)
    assert np.abs(np.log(np.array(heap.bin_inner) / shipped)).max() < np.log(1.45)
    assert heap.camera_distance == pytest.approx(workpiece.heap.camera_distance, rel=0.12)
    choice = next(c for c in rank_grippers(workpiece, heap.bin_inner[2]) if c.fits)
    fields, reasons = propose_cell(workpiece, choice.gripper, heap)
    scenario = Scenario.model_validate({"name": name, "workpiece": name, **fields})
    from pickproof.robots.kinematics.model import load_robot
    from pickproof.scenarios.picking.workcell import check_payload
    from pickproof.scenarios.placing.factory import check_room

    check_room(scenario, workpiece)
    check_payload(scenario, load_robot(scenario.robot), choice.gripper, workpiece)
    assert all(reasons.values())


def test_the_heap_is_sized_by_the_part_and_not_by_how_its_cad_lies() -> None:
    """A prism upright, and the same one slanted in its file: its bounding box there is half as large again."""
    mesh = mesh_of(extruded(polygon(6, 14), 12))
    heaps = []
    for T in (np.eye(4), trimesh.transformations.euler_matrix(0.7, 0.4, 0.2)):
        turned = mesh.copy().apply_transform(T)
        checked = Checked(np.asarray(turned.vertices), np.asarray(turned.faces))
        part = understand("nut", "steel", checked, *(found := search_symmetry(checked)), found[1].degrees)
        heaps.append(part.heap)
    assert heaps[0].count == heaps[1].count
    np.testing.assert_allclose(heaps[0].bin_inner, heaps[1].bin_inner, rtol=0.01)


def trying(monkeypatch: pytest.MonkeyPatch, holds: int) -> tuple[list[int], list[str]]:
    """Grasps tried of the bracket for a gripper each, and what is chosen, where every `holds`-th one holds.

    The clock runs away by 1000 s with every look.
    """
    seconds = itertools.count(0.0, 1000.0)
    for name in ("process_time", "monotonic", "perf_counter"):
        monkeypatch.setattr(f"time.{name}", lambda: next(seconds))
    counts: dict[str, int] = {}

    def tried(workpiece, gripper, points, iterations=None):
        before = counts.get(gripper.name, 0)
        counts[gripper.name] = before + len(points)
        return [p for i, p in enumerate(points, before) if holds and i % holds == 0]

    workpiece = load_workpiece("bracket")
    monkeypatch.setattr(onboard_part, "tried", tried)
    monkeypatch.setattr(onboard_part, "in_order_of_use", lambda workpiece, gripper, points: points)
    points = (load_grasps(workpiece, load_gripper("jaw_v1")).points * 40)[:72]
    monkeypatch.setattr(onboard_part, "propose", lambda *_: list(points))
    held = onboard_part.find_grasps(workpiece, propose_heap(workpiece.extents), lambda text: None)
    return list(counts.values()), [p.name for p in held.points]


def test_the_grasps_do_not_depend_on_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    counts, names = trying(monkeypatch, holds=2)
    assert counts == [48] and len(names) == onboard_part.ENOUGH


def test_the_grasps_that_are_tried_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    counts, names = trying(monkeypatch, holds=0)
    assert set(counts) == {onboard_part.GIVEN_UP} and sum(counts) <= onboard_part.TRIES and names == []
    counts, names = trying(monkeypatch, holds=30)  # the first, the 31st and the 61st
    assert counts == [72] and len(names) == 3
    monkeypatch.setattr(onboard_part, "TRIES", 50)
    counts, names = trying(monkeypatch, holds=30)
    assert counts == [50] and len(names) == 2
