"""Verdicts from the cell to the reader: the real planner's refusals, an attempt's tree, and what `explain` prints."""

from __future__ import annotations

import io
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from pickproof.cell.frames import Array, make_transform
from pickproof.cell.geometry.bin import Box
from pickproof.cell.workpiece.collision_pieces import CollisionBox
from pickproof.grasping.verdict import CHOSEN, Verdict
from pickproof.robots.collision.held_part import HeldPart
from pickproof.robots.collision.scene import CollisionScene, HeightField
from pickproof.robots.failure import PlanFailure
from pickproof.robots.kinematics.model import RobotModel, load_robot
from pickproof.robots.plan.pick_plan import check_grasps, plan_pick
from pickproof.scenarios.commands.cli import main
from pickproof.scenarios.picking.decision_tree import planning_verdict
from pickproof.scenarios.reporting.explain import explain
from pickproof.scenarios.reporting.report import verdict_rows
from pickproof.scenarios.reporting.verdict_counts import verdict_counts
from pickproof.scenarios.results.records import AttemptRecord
from pickproof.scenarios.results.store import FILE, Store
from tests.robots.arm_cell import CELL, DOWN, T_FLANGE_TOOL, TOOL, changed, request_at
from tests.scenarios.campaign.test_episode import run

NAMES = {box.name for box in TOOL}


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot("lrmate200id")


def refusal(failure: Any) -> PlanFailure:
    assert isinstance(failure, PlanFailure)
    return failure


@pytest.mark.parametrize(
    ("at", "verdict"),
    [
        ((1.1, 0.0, 0.035), Verdict.NO_IK),
        ((-0.40, 0.0, 0.30), Verdict.JOINT_LIMIT),
        ((0.563, 0.0, 0.05), Verdict.GRIPPER_BIN),
    ],
)
def test_where_the_arm_cannot_stand(robot: RobotModel, at: tuple[float, float, float], verdict: Verdict) -> None:
    scene = CollisionScene(robot, TOOL, CELL)
    (failure,) = check_grasps(scene, make_transform(DOWN, np.array([at])), T_FLANGE_TOOL)
    assert planning_verdict(refusal(failure), NAMES) == verdict


def test_an_outstretched_arm_is_singular(robot: RobotModel) -> None:
    """On the ray through the bin, out to the end of the reach, the last verdict before `no_ik` is `singularity`."""
    scene = CollisionScene(robot, TOOL, ())
    Ts = make_transform(DOWN, [[x, 0.0, 0.10] for x in np.arange(0.60, 0.75, 0.001)])
    seen = [None if f is None else planning_verdict(refusal(f), NAMES) for f in check_grasps(scene, Ts, T_FLANGE_TOOL)]
    kinds = list(dict.fromkeys(seen))
    assert kinds == [None, Verdict.SINGULARITY, Verdict.NO_IK]


def test_what_is_in_the_way_of_whom(robot: RobotModel) -> None:
    base = request_at(robot, 0.45, 0.0)
    wide = HeldPart((CollisionBox(size=(0.30, 0.05, 0.01), centre=(0, 0, 0)),), make_transform())
    above = make_transform(t=(0.0, 0.0, 0.15)) @ base.places.Ts_base_tool  # the part is free there
    lid = Box("lid", (0.26, 0.20, 0.01), make_transform(t=(0.45, 0, 0.13)))
    hill = HeightField(np.full((60, 60), 0.12), 0.33, -0.12, 0.004)
    cases = [
        (
            CollisionScene(robot, TOOL, CELL),
            changed(base, part={"held": wide}, places={"Ts_base_tool": above}),
            Verdict.HELD_BIN,
        ),
        (CollisionScene(robot, TOOL, [*CELL, lid]), base, Verdict.PATH_BLOCKED),
        (CollisionScene(robot, TOOL, CELL, hill), base, Verdict.GRIPPER_HEAP),
        (CollisionScene(robot, TOOL, CELL), changed(base, places={"Ts_base_tool": deep()}), Verdict.PATH_BLOCKED),
    ]
    for scene, request, verdict in cases:
        said = refusal(plan_pick(scene, request))
        assert planning_verdict(said, NAMES) == verdict, said


def deep() -> Array:
    return make_transform(DOWN, np.array([[0.25, -0.4, -0.05]]))


TREE = [
    {
        "score": 0.97,
        "position": [0.4, 0.1, 0.02],
        "ruled_out": {"top": {"tilt": 3, "outranked": 1}, "side": {"tilt": 2}},
        "candidates": [
            {"grasp": "top", "rank": 3.2, "terms": {"score": 0.97}, "verdict": "no_ik", "detail": "unreachable: far"},
            {"grasp": "side", "rank": 3.0, "terms": {"score": 0.97, "height": 0.5}, "verdict": "chosen"},
        ],
    },
    {"score": 0.4, "position": [0.4, 0.1, 0.02], "ruled_out": {"top": {"score": 4}}, "candidates": []},
]


def record(**changes: Any) -> AttemptRecord:
    fields = {"seed": 5, "attempt": 0, "moved": True, "success": True, "reason": "", "parts_in_bin_before": 5}
    return AttemptRecord(**{**fields, "n_estimates": 2, "grasp": "side", "tree": TREE, **changes})


def printed(attempt: AttemptRecord) -> str:
    out = io.StringIO()
    explain(attempt, 7, Console(file=out, width=120))
    return out.getvalue()


def test_counts_of_a_tree_are_of_all_its_poses() -> None:
    assert verdict_counts(TREE) == {"tilt": 5, "outranked": 1, "no_ik": 1, "chosen": 1, "score": 4}
    assert verdict_counts({"error": "a worker died"}) == verdict_counts(None) == {}
    shares = verdict_rows([record(), record(attempt=1), record(attempt=2, tree={"error": "x"})])
    assert sum(n for _, n, _, _ in shares) == 2 * 11 and CHOSEN not in {v for v, *_ in shares}
    assert sum(share for _, _, share, _ in shares) == pytest.approx(11 / 12)


def test_it_says_who_was_chosen_why_the_others_were_not_and_how_it_ended() -> None:
    text = printed(record())
    for words in (
        "attempt 7",
        "seed 5",
        "side: chosen, rank 3.00",
        "height 0.50",
        "far",
        "3 tilt",
        "success with side",
    ):
        assert words in text
    assert "tilt alone: side 2" in text
    text = printed(record(success=False, reason="slipped"))
    assert "slipped" in text and "lost while lifting" in text
    text = printed(record(moved=False, success=False, reason="no_detection", grasp="", tree=[]))
    assert "no estimates" in text and "did not move" in text
    assert "died" in printed(record(success=False, reason="simulation_error", tree={"error": "worker died"}))


def test_a_run_can_be_explained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = run(seed=11, count=2)
    with Store.create(tmp_path, {}) as store:
        for attempt in done.attempts:
            store.add_attempt(attempt)
    for n, attempt in enumerate(done.attempts):
        assert main(["explain", str(tmp_path), "--attempt", str(n)]) == 0
        out = capsys.readouterr().out
        assert f"{attempt.grasp}: chosen" in out and "success" in out
        counts = verdict_counts(attempt.tree)
        assert counts[CHOSEN] == 1 and set(counts) <= {CHOSEN, *map(str, Verdict)}
    for bad in ("-1", str(len(done.attempts)), "first", "1.5"):
        assert main(["explain", str(tmp_path), f"--attempt={bad}"]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and f"'{bad}'" in error and f"from 0 to {len(done.attempts) - 1}" in error


def test_the_other_attempts_are_not_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Store.create(tmp_path, {}) as store:
        for n in range(5):
            store.add_attempt(record(attempt=n))
    with sqlite3.connect(tmp_path / FILE) as db:  # whoever decodes another row fails
        db.execute("UPDATE attempts SET tree = 'no JSON', waypoints = 'no JSON' WHERE attempt != 3")
    db.close()
    assert main(["explain", str(tmp_path), "--attempt", "3"]) == 0
    assert "attempt 3" in capsys.readouterr().out
    assert main(["explain", str(tmp_path), "--attempt", "2"]) != 0


def test_no_attempt_at_all(tmp_path: Path) -> None:
    with Store.create(tmp_path, {}) as store, pytest.raises(Exception, match="there is no attempt"):
        store.nth_attempt(0)
