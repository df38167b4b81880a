"""An attempt that was run, stored, written as a TP program and read again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pickproof.cell.grippers.registry import load_gripper
from pickproof.robots.kinematics.model import forward, load_robot
from pickproof.robots.motion.blended_motion import OFF_LINE
from pickproof.scenarios.commands.cli import main
from pickproof.scenarios.config.scenario import load_scenario, scenario_json
from pickproof.scenarios.results.records import AttemptRecord, Reason
from pickproof.scenarios.results.store import Store
from tests.robots.program.tp_reader import parse_program
from tests.scenarios.campaign.test_episode import run


def test_the_program_of_a_pick(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = run(seed=11, count=2)
    idle = AttemptRecord(11, 99, False, False, Reason.NO_DETECTION, 0, 0, tree=[])
    with Store.create(tmp_path, {"scenario": scenario_json(load_scenario("bracket"))}) as store:
        for attempt in [*done.attempts, idle]:
            store.add_attempt(attempt)
    assert main(["export-program", str(tmp_path), "--attempt", "1", "--output", "7"]) == 0
    assert "PICK_1.LS" in capsys.readouterr().out

    robot, T_flange_tool = load_robot("lrmate200id"), load_gripper("jaw_v1").T_flange_tool
    program = parse_program((tmp_path / "PICK_1.LS").read_text(), robot)
    assert program.name == "PICK_1" and program.outputs == [(7, True), (7, False)]
    stored = done.attempts[1].waypoints
    points = []
    for (motion, number, _, cnt), waypoint in zip(program.moves, stored, strict=True):
        assert (motion, cnt) == (waypoint["motion"], waypoint["cnt"])
        position = program.positions[number]
        T = position.T_base_tool if position.joints is None else forward(robot, position.joints) @ T_flange_tool
        assert T is not None
        np.testing.assert_allclose(T, forward(robot, np.array(waypoint["q"])) @ T_flange_tool, atol=5e-6)
        points.append(T[:3, 3])
    carry = load_scenario("bracket").carry
    for gripper in ("close", "open"):  # into grasp and place on a line, and to a stop
        (at,) = [i for i, w in enumerate(stored) if w["gripper"] == gripper]
        assert stored[at]["motion"] == "L" and stored[at]["cnt"] is None
        T = forward(robot, np.array(stored[at]["q"])) @ T_flange_tool
        way = points[at] - points[at - 1]
        straight = carry.straight if gripper == "close" else carry.straight_place
        assert 0.8 * straight < np.linalg.norm(way) <= straight
        down = T[:3, 2] if gripper == "close" else np.array([0.0, 0.0, -1.0])
        assert way @ down > 0.0 and np.linalg.norm(np.cross(way, down)) < 1.1 * OFF_LINE
    start = np.array(done.attempts[0].waypoints[-1]["q"])
    np.testing.assert_allclose(stored[0]["q"], start, atol=1e-6)  # where the arm waited after the pick before

    assert main(["export-program", str(tmp_path), "--attempt", str(len(done.attempts))]) == 2
    assert "the arm moved" in capsys.readouterr().err
    assert main(["export-program", str(tmp_path), "--attempt", "0", "--name", "7up"]) == 2
    assert "--name" in capsys.readouterr().err
