import re
import shutil

import pytest

from pickproof.cell.grippers.registry import SHIPPED as GRIPPERS
from pickproof.scenarios.config import input_hashes as inputs
from pickproof.scenarios.config.input_hashes import changed, input_hashes, inputs_hash, versions
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.config.shipped import WORKPIECES


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Copies of all that a scenario of brackets reads, by what they are called there."""
    part = tmp_path / "parts" / "bracket"
    shutil.copytree(WORKPIECES / "bracket", part, ignore=shutil.ignore_patterns("variants"))
    shutil.copy(GRIPPERS / "jaw_v1.yaml", tmp_path / "mine.yaml")
    robot = tmp_path / "robots" / "lrmate200id"
    shutil.copytree(inputs.ROOT / "robots" / "lrmate200id", robot)
    with (part / "workpiece.yaml").open("a") as yaml:
        yaml.write("collision_hulls: hulls.obj\n")
    block = "\n".join(f"v {x} {y} {z}" for x in (-20, 20) for y in (-10, 10) for z in (-10, 10))
    (part / "hulls.obj").write_text(f"o piece\n{block}\n")
    (part / "score.json").write_text("{}")
    monkeypatch.setenv("PICKPROOF_WORKPIECES", str(tmp_path / "parts"))
    monkeypatch.setattr(inputs, "ROOT", tmp_path)
    return {
        "workpiece.yaml": part / "workpiece.yaml",
        "mesh": part / "bracket.ply",
        "collision_hulls": part / "hulls.obj",
        "grasps.yaml": part / "grasps.yaml",
        "score.json": part / "score.json",
        "gripper": tmp_path / "mine.yaml",
        "robot": robot / "robot.urdf",
    }


def hashes(files, oracle=()):
    return input_hashes(load_scenario("bracket", [f"gripper={files['gripper']}"]), oracle)


def test_every_file_that_decides_a_result_is_named_when_it_changes(files):
    before = hashes(files)
    assert before.keys() == files.keys() and all(before.values())
    for name, path in files.items():
        kept = path.read_bytes()
        path.write_bytes(kept + b"\n")
        now = hashes(files)
        assert changed({"inputs": before}, {"inputs": now}) == [f"inputs.{name}"]
        assert inputs_hash(now) != inputs_hash(before)
        path.write_bytes(kept)
    assert hashes(files) == before


def test_a_file_that_goes_away_is_a_change(files):
    before = hashes(files)
    files["score.json"].unlink()
    assert changed({"inputs": before}, {"inputs": hashes(files)}) == ["inputs.score.json"]


def test_the_score_does_not_count_for_perfect_poses(files):
    before = hashes(files, {"perception"})
    files["score.json"].write_text("{ }")
    assert hashes(files, {"perception"}) == before


def test_older_results_say_nothing_of_inputs():
    assert changed({"seed": 0}, {"seed": 0, "inputs": {"mesh": "aa"}}) == ["inputs"]


def test_versions_name_the_source_as_well():
    assert re.fullmatch(r"[0-9a-f]{16}", versions()["code"])
    assert "not installed" not in {versions()[name] for name in ("numpy", "pybullet", "ruckig", "pin")}
