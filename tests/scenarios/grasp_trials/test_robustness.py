"""The robustness of a grasp: closed forms, and one grasp in the physics."""

from __future__ import annotations

import json
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from pickproof.cell.frames import rotation_angle
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.grasp_points import load_grasps
from pickproof.scenarios.commands.cli import main
from pickproof.scenarios.grasp_trials.robustness import (
    AXES,
    KEYS,
    Robustness,
    Task,
    axis_error,
    beyond,
    document,
    try_robustness,
    verdict,
)
from pickproof.scenarios.grasp_trials.robustness_report import plot_robustness, robustness_table

pytestmark = pytest.mark.slow


def grasp(held: np.ndarray, reasons: tuple[str, ...] = ("",) * 6) -> Robustness:
    return Robustness("edge", 0, "", held, reasons, ("closing", "across", "approach") * 2)


def test_what_is_tolerated_ends_at_the_first_loss() -> None:
    held = np.ones((6, 13), dtype=bool)
    held[0, 6 + 3] = False  # +2 mm along x; what holds beyond it does not count
    held[4, 6 - 1] = False  # -1 degree about y
    found = grasp(held).tolerated
    np.testing.assert_array_equal(found[0], [6.0, 1.0])
    np.testing.assert_array_equal(found[4], [0.0, 15.0])
    np.testing.assert_array_equal(found[3], [15.0, 15.0])
    assert grasp(held).share == pytest.approx(76 / 78)
    held[:, 6] = False
    np.testing.assert_array_equal(grasp(held).tolerated, 0.0)


def test_the_verdict_names_the_direction_in_which_perception_errs_by_more() -> None:
    held = np.ones((6, 13), dtype=bool)
    held[0, 6 + 3 :] = False
    one = grasp(held, ("closed on nothing", *("",) * 5))
    errors = dict.fromkeys(KEYS, 0.8)
    assert beyond(one, errors) == [] and verdict(one, errors) == "tolerates the errors of perception"
    errors["x_mm"] = 1.4
    assert [AXES[a] for a in beyond(one, errors)] == ["x"]
    line = verdict(one, errors)
    assert "will fail" in line and "1.4 mm along x (closing)" in line
    assert "tolerates 1 mm" in line and "on nothing" in line
    assert "along x" in verdict(one, None)
    console = Console(width=80, record=True, file=StringIO())
    console.print(robustness_table([one], errors))
    shown = console.export_text()
    assert "…" not in shown and "held" in shown and " %" in shown


def test_errors_are_the_size_that_they_say() -> None:
    np.testing.assert_allclose(axis_error(1, -3.0)[:3, 3], [0.0, -0.003, 0.0])
    assert rotation_angle(axis_error(5, 10.0)[:3, :3]) == pytest.approx(np.deg2rad(10.0))


def test_a_grasp_across_a_thin_flange_tolerates_least_along_the_closing_direction(tmp_path: Path) -> None:
    point = next(
        p for p in load_grasps(load_workpiece("bracket"), load_gripper("jaw_v1")).points if p.name == "flange_from_side"
    )
    found = try_robustness(Task("bracket", "jaw_v1", point))
    assert found.reason == "" and found.along[0] == "closing"
    least = found.tolerated.min(1)[:3]
    assert 0.5 <= least[0] <= 4.0  # 2.5 mm of room on each side of 8 mm
    assert least.argmin() in (0, 2) and found.reasons[0]
    errors = dict.fromkeys(KEYS, 0.1)
    errors["x_mm"] = 5.0
    assert "will fail" in verdict(found, errors) and robustness_table([found], errors).row_count == 2
    plot_robustness([found], errors, "bracket", tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 10_000
    assert (
        json.loads(json.dumps(document([found], errors)))["grasps"][0]["tolerated"]["x_mm"]
        == found.tolerated[0].tolist()
    )


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["--grasps", "handle"], ["--grasps", "handle", "plate_from_top"]),
        (["--errors", "nowhere.json"], ["nowhere.json", "missing file"]),
        (["--table", "nowhere.yaml"], ["nowhere.yaml", "missing file"]),
    ],
)
def test_bad_input_is_one_line(words: list[str], names: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["grasps", "robustness", "bracket", *words]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    for name in names:
        assert name in error


def test_an_evaluation_without_errors_by_axis_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "evaluation.json"
    file.write_text('{"methods": {}}')
    assert main(["grasps", "robustness", "bracket", "--errors", str(file)]) == 2
    assert "axis_errors" in capsys.readouterr().err
