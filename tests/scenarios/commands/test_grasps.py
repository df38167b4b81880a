"""`pickproof grasps`, as a user types it."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.grasp_points import GraspTable, load_grasps
from pickproof.scenarios.commands.cli import main

pytestmark = pytest.mark.slow

HAND = ["--tool", "0", "0", "0.1034", "0", "0", "90"]


def test_export_and_import_are_inverse(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, back = tmp_path / "isaac.yaml", tmp_path / "grasps.yaml"
    assert main(["grasps", "export", "bracket", "--out", str(file), *HAND]) == 0
    assert main(["grasps", "import", "bracket", str(file), "--out", str(back), *HAND]) == 0
    assert capsys.readouterr().out == f"wrote {file}\nwrote {back}\n"
    table = GraspTable.model_validate(yaml.safe_load(back.read_text()))
    poses = load_grasps(load_workpiece("bracket"), load_gripper("jaw_v1"))
    assert table.gripper == "jaw_v1"
    assert len(table.grasps) == len(poses.index)


def test_the_gripper_is_that_of_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["grasps", "export", "tless_20"]) == 0
    assert "jaw_deep" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["import", "bracket", "nowhere.yaml"], ["nowhere.yaml", "missing file"]),
        (["import", "nonesuch", "nowhere.yaml"], ["workpiece", "nonesuch", "bracket"]),
        (["export", "bracket", "--gripper", "hand"], ["gripper", "hand", "jaw_v1"]),
        (["export", "bracket", "--tool", "0", "0"], ["--tool", "6 arguments"]),
        (["sample", "bunny", "--least", "1.5"], ["--least", "1.5", "0.999"]),
        (["fly"], ["fly", "import", "export"]),
        ([], ["COMMAND"]),
    ],
)
def test_bad_input_is_one_line(words: list[str], names: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["grasps", *words]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    for name in names:
        assert name in error


def test_another_frame_is_noticed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Read without the frame that it was written in, the grasps are in the air, 10 cm off the part."""
    file = tmp_path / "isaac.yaml"
    assert main(["grasps", "export", "bracket", "--out", str(file), *HAND]) == 0
    assert main(["grasps", "import", "bracket", str(file)]) == 2
    error = capsys.readouterr().err
    assert str(file) in error and "--tool" in error and error.count("\n") == 1
