"""`pickproof tune`: what it may change, the whole way through with stand-ins, and one short search in the physics."""

from __future__ import annotations

import json
import shutil
from base64 import b64decode
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickproof.cell.frames import make_transform
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.grasp_points import GraspPoint, first_pose, opening, read_table
from pickproof.scenarios.campaign.parallel_map import mapping
from pickproof.scenarios.campaign.request import CampaignRequest
from pickproof.scenarios.commands.cli import main
from pickproof.scenarios.config.scenario import SHIPPED, Scenario, load_scenario
from pickproof.scenarios.files.grasps_text import table_text
from pickproof.scenarios.grasp_trials.trial import TrialCell
from pickproof.scenarios.results.store import FILE, Store
from pickproof.scenarios.tuning import cell_objective as tune_bins
from pickproof.scenarios.tuning.cell_space import Cell, candidate, cell_parameters
from pickproof.scenarios.tuning.cell_stage import winner
from pickproof.scenarios.tuning.grasp_objective import GraspTask, draw_errors, straddled, try_point
from pickproof.scenarios.tuning.grasp_space import SHIFTS, TURNS, Reach, distance, grasp_parameters, moved
from pickproof.scenarios.tuning.optimizer import Parameter, Search, Told, open_journal
from pickproof.scenarios.tuning.plan import Plan, Runners
from pickproof.scenarios.tuning.proposal import changed_scenario, changed_table
from pickproof.scenarios.tuning.report import move
from pickproof.scenarios.tuning.run import Result, run_plan
from pickproof.scenarios.tuning.scenario_fields import parse_field, with_fields
from tests.scenarios import planted_episode, planted_tune

pytestmark = pytest.mark.slow

TABLE = SHIPPED / "workpieces" / "bracket" / "grasps.yaml"
POINTS = {p.name: p for p in read_table(TABLE).grasps}
JAW = load_gripper("jaw_v1")
STILL = dict.fromkeys((*SHIFTS, *TURNS, "depth_mm"), 0.0)


def test_a_grasp_point_that_is_not_moved_is_the_same() -> None:
    for point in POINTS.values():
        start = {p.name: p.start for p in grasp_parameters(point, JAW, Reach())}
        assert moved(point, start) == point


def test_moves_are_what_they_say() -> None:
    rng = np.random.default_rng(0)
    for point in POINTS.values():
        parameters = grasp_parameters(point, JAW, Reach(0.006, 12.0))
        values = {p.name: float(rng.uniform(p.low, p.high)) for p in parameters}
        new = moved(point, values)
        shift = 1000 * (np.array(new.centre) - point.centre)
        np.testing.assert_allclose(shift, [values[n] for n in SHIFTS], atol=0.006)
        assert np.abs(shift).max() <= 6.01 and opening(new) == pytest.approx(1e-3 * values["opening_mm"], abs=1e-5)
        turn = np.arccos(np.dot(new.approach, point.approach) / np.linalg.norm(new.approach))
        about = np.deg2rad([values[n] for n in TURNS])
        assert turn <= np.linalg.norm(about) + 1e-6
        assert new.depths[0] - point.depths[0] == pytest.approx(1e-3 * values["depth_mm"], abs=1e-5)
    turned = moved(POINTS["plate_from_top"], STILL | {"closing_deg": 10.0})
    assert np.degrees(np.arccos(-turned.approach[2])) == pytest.approx(10.0, abs=1e-3)
    assert turned.closing == (0.0, 1.0, 0.0)


@pytest.mark.parametrize("workpiece", sorted(p.parent.name for p in SHIPPED.glob("workpieces/*/grasps.yaml")))
def test_comments_and_layout_of_a_table_are_kept(workpiece: str) -> None:
    path = SHIPPED / "workpieces" / workpiece / "grasps.yaml"
    points = read_table(path).grasps
    text = changed_table(path, points, points)
    assert [line for line in text.splitlines() if "#" in line] == [
        line for line in path.read_text().splitlines() if "#" in line
    ]
    new = [points[0].model_copy(update={"priority": 0.125}), *points[1:]]
    changed = changed_table(path, points, new)
    assert sum(a != b for a, b in zip(text.splitlines(), changed.splitlines(), strict=False)) >= 1
    assert changed.count("0.125") == text.count("0.125") + 1


def test_a_scenario_is_changed_in_place(tmp_path: Path) -> None:
    text = changed_scenario(SHIPPED / "bracket.yaml", {"camera.eye.2": 0.9, "perception.min_score": 0.7}, "grasps.yaml")
    (tmp_path / "s.yaml").write_text(text)
    shutil.copy(TABLE, tmp_path)
    new, old = load_scenario(str(tmp_path / "s.yaml")), load_scenario("bracket")
    assert new.camera.eye == (0.45, 0.0, 0.9) and new.perception.min_score == 0.7
    restored = new.model_copy(update={"camera": old.camera, "perception": old.perception, "grasps": ""})
    assert restored == old and "# light, and no arms" in text


def test_candidates_change_what_their_values_say() -> None:
    scenario = load_scenario("bracket")
    field = parse_field("camera.eye.2=0.8:0.95", scenario)
    assert field is not None and field.start == 0.86
    points = list(POINTS.values())
    parameters = cell_parameters(points[:2], scenario, [field], choose_table=True)
    start = {p.name: p.start for p in parameters}
    assert candidate(start, (points, points[::-1]), scenario) == (points, scenario)
    change = {"table": 1, "priority plate_from_top": 0.25, "approach_factor": 1.5, "camera.eye.2": 0.9}
    new, cell = candidate(start | change | {"grasping.weight_height": 1.5}, (points, points[::-1]), scenario)
    assert [p.name for p in new] == [p.name for p in points[::-1]]
    by_name = {p.name: p for p in new}
    assert by_name["plate_from_top"].priority == 0.25 and by_name["plate_from_top"].approach_distance == 0.09
    assert by_name["edge_of_rib"] == POINTS["edge_of_rib"]
    assert cell.camera.eye[2] == 0.9 and cell.grasping.weight_height == 1.5


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["--grasps", "handle"], ["--grasps", "handle", "plate_from_top"]),
        (["--grasps", "none"], ["--grasps", "none", "LOW:HIGH"]),
        (["--budget", "soon"], ["--budget", "soon", "90s"]),
        (["--set", "camera.eye.7=0.8:0.9"], ["camera.eye.7", "number"]),
        (["--set", "gripper=1:2"], ["gripper", "number"]),
        (["--set", "count=10:20"], ["count", "source_bin"]),
        (["--set", "carry.speed_scale=0.5:1.5"], ["carry.speed_scale", "1.5"]),
        (["--set", "carry.speed_scale=0.9:0.5"], ["--set", "0.9:0.5", "smaller"]),
        (["--set", "carry.speed_scale=0.5:inf"], ["--set", "0.5:inf"]),
        (["--set", "camera.width=640.2:640.8"], ["--set", "camera.width", "whole numbers"]),
        (["--set", "camera.width=640:700", "--set", "camera.width=600:640"], ["--set", "camera.width", "one range"]),
        (["--errors", "nowhere.json"], ["nowhere.json", "pickproof evaluate"]),
        (["--block", "9"], ["--block", "9", "--episodes"]),
        (["--resume"], ["--resume", "--out"]),
        (["--accept", "--out", "nowhere"], ["nowhere", "pickproof tune"]),
    ],
)
def test_bad_input_is_one_line(words: list[str], names: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tune", "bracket", *words]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    for name in names:
        assert name in error


@pytest.fixture
def campaigns_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted episodes in this process: that campaigns do not depend on workers is tested in test_campaign.py."""

    def here(request: CampaignRequest) -> None:
        (request.out / FILE).unlink(missing_ok=True)
        planted_episode.write_campaign(request.out, request.scenario, request.seeds)

    monkeypatch.setattr(tune_bins, "run_campaign", here)


def plan_in(out: Path, workers: int = 1) -> Plan:
    scenario = load_scenario("bracket", ["count=5", "carry.speed_scale=0.6"])
    field = parse_field("carry.speed_scale=0.5:1.0", scenario)
    names = ("plate_from_top", "edge_of_plate")
    return Plan(
        scenario, TABLE, JAW.name, tuple(POINTS.values()), names, (field,) if field else (),
        frozenset({"perception"}), out, Reach(),
        generations=2, rounds=2, episodes=4, block=2, holdout=4, workers=workers,
    )  # fmt: skip


def tuned(out: Path, workers: int) -> Result:
    plan = plan_in(out, workers)
    with mapping(workers) as run:
        return run_plan(plan, open_journal(out), Runners(run, planted_episode.run_episode, planted_tune.trial))


@pytest.mark.parametrize(
    ("gains", "half_width", "wins"),
    [
        ((0.0, 0.30, 0.36, 0.40), 0.10, 2),  # 0.40 is luck: one standard error is 0.05
        ((0.0, 0.30, 0.36, 0.45), 0.10, 3),
        ((0.0, -0.1, -0.2, 0.10), 0.50, 3),  # a given cell that loses is never taken
        ((0.0, -0.1, -0.2, -0.1), 0.10, None),
        ((0.0, 0.2, 0.1, 0.15), 0.10, 1),
    ],
)
def test_drawn_weights_must_be_clearly_better_than_the_moved_table(
    tmp_path: Path, gains: tuple[float, ...], half_width: float, wins: int | None
) -> None:
    """Weights drawn at random won by two picks in four bins, and lost 16 points in the unseen ones."""
    weight = Parameter("grasping.weight_height", 0.0, 2.0, 1.0)
    search = Search(open_journal(tmp_path), "cell", [weight], 0, [{weight.name: 1.2}, {weight.name: 1.4}])
    search.tell(search.ask(4)[:0], [])  # asked, and then interrupted
    search = Search(open_journal(tmp_path), "cell", [weight], 0, [{weight.name: 1.2}, {weight.name: 1.4}])
    asked = search.ask(4)
    told = [Told(g, {"dropped": False, "interval95": [g - half_width, g + half_width]}) for g in gains]
    search.tell(asked, told)
    found = winner(search)
    assert (None if found is None else gains.index(found.value)) == wins


def test_the_page_says_what_moved(tmp_path: Path) -> None:
    point, plan = POINTS["plate_from_top"], plan_in(tmp_path)
    still = move(plan, point, point)
    assert not any((still.centre, still.turned, still.depth, still.jaws, still.priority, still.picture))
    values = STILL | {"x_mm": 2.0, "closing_deg": 10.0, "depth_mm": -1.5, "opening_mm": 30.0}
    found = move(plan, point, moved(point, values).model_copy(update={"priority": 0.25}))
    assert (found.centre, found.turned, found.depth) == ("+2.0, +0.0, +0.0", "10.0", "-1.5")
    assert found.jaws == "23.0 \u2192 30.0" and found.priority == "1.00 \u2192 0.25"
    assert b64decode(found.picture).startswith(b"\x89PNG")


def test_the_outcome_does_not_depend_on_the_number_of_workers(tmp_path: Path, campaigns_here: None) -> None:
    one, two = tuned(tmp_path / "one", 1), tuned(tmp_path / "two", 2)
    assert one.history == two.history and one.points == two.points and one.scenario == two.scenario
    assert one.comparison is not None and two.comparison is not None
    here: dict[str, Any] = {"changed": [], "differ": {}}  # paths of the two folders
    assert replace(one.comparison, **here) == replace(two.comparison, **here)
    for change in one.grasps:
        assert change.changed and change.share[1] > change.share[0]
    assert one.fields["carry.speed_scale"] > 0.8  # the chance that a planted attempt succeeds


def test_command_searches_resumes_and_writes_in_place(
    tmp_path: Path, campaigns_here: None, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "cell.yaml", tmp_path / "out"
    file.write_text((SHIPPED / "bracket.yaml").read_text() + "# kept\n")
    words = ["tune", str(file), "--out", str(out), "--grasps", "none", "--oracle", "perception", "--set", "count=8"]
    effort = {"rounds": 1, "episodes": 8, "block": 8, "holdout": 8}
    words += ["--set", "carry.speed_scale=0.3:0.9", *(w for k, v in effort.items() for w in (f"--{k}", str(v)))]
    file.write_text(file.read_text().replace("speed_scale: 1.0", "speed_scale: 0.4"))
    assert main(words) == 0
    shown = capsys.readouterr().out
    assert "better" in shown and "paired episodes" in shown
    page = (out / "tune.html").read_text()
    assert "Plotly.newPlot" in page and "carry.speed_scale" in page and "<link" not in page
    found = json.loads((out / "tune.json").read_text())
    assert found["fields"]["carry.speed_scale"] > 0.6 and found["comparison"]["verdict"] == "better"
    assert main(words) == 2 and "--resume" in capsys.readouterr().err
    assert main([*words, "--set", "carry.straight=0.02", "--resume"]) == 2
    assert "changed: scenario" in capsys.readouterr().err
    assert main([*words, "--resume"]) == 0
    assert json.loads((out / "tune.json").read_text())["history"] == found["history"]
    accepting = ["tune", str(file), "--out", str(out), "--accept"]
    proposed = file.read_text()
    file.write_text(proposed.replace("speed_scale: 0.4", "speed_scale: 0.5"))
    capsys.readouterr()
    assert main(accepting) == 2 and "changed since the search" in capsys.readouterr().err
    file.write_text(proposed)
    assert main(accepting) == 0
    assert load_scenario(str(file)).count == 30  # fixed for the search, no proposal
    text = file.read_text()
    assert load_scenario(str(file)).carry.speed_scale == found["fields"]["carry.speed_scale"]
    assert (
        "# kept" in text and "# light, and no arms" in text and TABLE.read_text() == (out / "grasps.yaml").read_text()
    )


def test_a_grasp_beside_the_part_is_moved_onto_it_in_the_physics(tmp_path: Path) -> None:
    """The edge of the 5 mm plate, taken 5 mm too high, closes on nothing; the first trials of the search mend it."""
    good = POINTS["edge_of_plate"]
    bad = good.model_copy(update={"centre": (good.centre[0], good.centre[1], good.centre[2] + 0.005)})
    errors = draw_errors(np.random.default_rng(0), load_workpiece("bracket"), draws=2)

    def tried(point: GraspPoint) -> float:
        return try_point(GraspTask("bracket", "jaw_v1", point, errors)).value

    first = try_point(GraspTask("bracket", "jaw_v1", good, errors))
    assert first.detail["share"] == 1.0 and first.detail["trials"] == 3
    low = try_point(GraspTask("bracket", "jaw_v1", bad, errors))
    assert low.detail["share"] == 0.0 and low.detail["reason"]
    ends = [tried(moved(bad, STILL | {"z_mm": z})) for z in (-6.0, 6.0)]
    assert ends[0] > 0.5 > ends[1]
    assert (
        try_point(GraspTask("bracket", "jaw_v1", good, errors)) == first
    )  # to the last bit, whatever was tried before


def test_a_grasp_that_pushes_is_worth_less() -> None:
    """Both hold under every error; the one that closes 4 mm off would push neighbours."""
    good = POINTS["edge_of_plate"].model_copy(update={"opening": POINTS["edge_of_plate"].width + 0.012, "stroke": None})
    centre = np.asarray(good.centre) + 0.004 * np.asarray(good.closing)
    errors = draw_errors(np.random.default_rng(0), load_workpiece("bracket"), draws=3)
    still, off = (
        try_point(GraspTask("bracket", "jaw_v1", point, errors))
        for point in (good, good.model_copy(update={"centre": tuple(centre.tolist())}))
    )
    assert still.detail["share"] == off.detail["share"] == 1.0
    assert off.detail["pushed_mm"] > still.detail["pushed_mm"] + 1.5 and off.value < still.value - 0.05


def test_a_grasp_that_holds_nothing_is_worth_more_the_nearer_it_comes() -> None:
    """A jaw 1 mm wider than the plate and off along its closing direction strikes it; the physics only says no."""
    good = POINTS["edge_of_plate"]
    with closing(TrialCell(load_workpiece("bracket"), load_gripper("jaw_v1"))) as cell:
        T_part_tool = first_pose(good)
        over = [
            straddled(cell, np.eye(4), T_part_tool @ make_transform(t=(off, 0.0, 0.0)), good.width + 0.001)
            for off in (0.0, 0.002, 0.004, 0.006)
        ]
    assert over[0] == 1.0 and over == sorted(over, reverse=True) and len(set(over)) == 4
    centre = np.asarray(good.centre) + 0.004 * np.asarray(good.closing)
    bad = good.model_copy(update={"opening": good.width + 0.001, "stroke": None, "centre": tuple(centre.tolist())})
    errors = draw_errors(np.random.default_rng(0), load_workpiece("bracket"), draws=2)
    told = try_point(GraspTask("bracket", "jaw_v1", bad, errors))
    assert told.detail["share"] == 0.0 and 0.0 < told.value < 0.2


def test_a_list_that_the_scenario_leaves_to_its_default_is_written_whole(tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    file.write_text("name: s  # kept\nworkpiece: bracket\n")
    before = load_scenario(str(file))
    file.write_text(changed_scenario(file, {"camera.eye.2": 0.91, "perception.min_score": 0.7}, None))
    after = load_scenario(str(file))
    assert after.camera.eye == (*before.camera.eye[:2], 0.91) and after.perception.min_score == 0.7
    assert "# kept" in file.read_text()


@pytest.mark.parametrize("reach", [Reach(0.0, 15.0), Reach(0.008, 0.0), Reach(0.0, 0.0)])
def test_what_may_not_be_moved_is_no_parameter(reach: Reach) -> None:
    point = POINTS["plate_from_top"]
    parameters = grasp_parameters(point, JAW, reach)
    start = {p.name: p.start for p in parameters}
    assert all(p.low < p.high for p in parameters) and distance(parameters, start) == 0.0
    assert moved(point, start) == point


def test_resuming_with_another_winner_compares_that_one(tmp_path: Path, campaigns_here: None) -> None:
    """`new` held what the search proposed before it was continued, and was taken for the new proposal's result."""
    plan = plan_in(tmp_path)
    points, scenario = list(plan.points), plan.scenario
    for speed in (0.6, 0.9):
        cell = with_fields(scenario, {"carry.speed_scale": speed})
        tune_bins.run_folder(
            plan, planted_episode.run_episode, tmp_path / "new", Cell(points, cell), tune_bins.Bins(7, 4)
        )
    slow, fast = load_speed(tmp_path / "new-2"), load_speed(tmp_path / "new")
    assert (slow, fast) == (0.6, 0.9)
    other = [points[0].model_copy(update={"priority": 0.125}), *points[1:]]
    tune_bins.run_folder(plan, planted_episode.run_episode, tmp_path / "new", Cell(other, cell), tune_bins.Bins(7, 4))
    assert read_table(tmp_path / "new" / "grasps.yaml").grasps[0].priority == 0.125


def load_speed(folder: Path) -> float:
    with Store.read(folder) as store:
        return Scenario.model_validate_json(store.meta()["scenario"]).carry.speed_scale


def test_bins_that_ended_out_of_order_are_not_taken_for_the_first(tmp_path: Path, campaigns_here: None) -> None:
    """Two workers, interrupted: seeds 7 and 9 have ended, 8 has not."""
    plan = plan_in(tmp_path)
    folder, points = tmp_path / "one", list(plan.points)
    planted_episode.write_campaign(folder, plan.scenario, range(7, 11, 2))
    (folder / "grasps.yaml").write_text(table_text(points, plan.gripper))
    found = tune_bins.run_folder(
        plan, planted_episode.run_episode, folder, Cell(points, plan.scenario), tune_bins.Bins(7, 2)
    )
    assert [o.seed for o in found] == [7, 8]
