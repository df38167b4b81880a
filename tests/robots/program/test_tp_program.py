from __future__ import annotations

import numpy as np
import pytest

from pickproof.cell.errors import InputError
from pickproof.cell.frames import from_rpy
from pickproof.robots.kinematics.inverse import inverse
from pickproof.robots.kinematics.model import RobotModel, forward, load_robot, to_pendant
from pickproof.robots.program.tp_program import Waypoint, configuration, write_program
from tests.robots.program.tp_reader import Program, parse_program

T_FLANGE_TOOL = from_rpy((0.01, -0.02, 0.18), (0.0, 0.0, 0.3))


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot("lrmate200id")


def pick(robot: RobotModel) -> list[Waypoint]:
    above, grasp = np.deg2rad([10, 20, -30, 5, -70, 12]), np.deg2rad([10, 25, -33, 5, -72, 12])
    turned = np.deg2rad([-40, 15, -25, 10, -80, 200])
    return [
        Waypoint(robot.home, "J", 1.0),
        Waypoint(above, "J", 0.8, cnt=50),
        Waypoint(grasp, "L", 0.25, gripper="close"),
        Waypoint(above, "L", 0.25, cnt=100),
        Waypoint(turned, "L", 0.1, gripper="open"),
    ]


def written(robot: RobotModel) -> tuple[str, Program]:
    text = write_program(robot, pick(robot), T_FLANGE_TOOL, "PICK_7", "bracket 7", output=3)
    return text, parse_program(text, robot)


def test_what_was_written_is_read_again(robot: RobotModel) -> None:
    text, program = written(robot)
    points = pick(robot)
    assert program.name == "PICK_7"
    assert program.moves == [("J", 1, 1.0, None), ("J", 2, 0.8, 50), ("L", 3, 0.25, None), ("L", 4, 0.25, 100),
                             ("L", 5, 0.1, None)]  # fmt: skip
    assert program.outputs == [(3, True), (3, False)]
    np.testing.assert_allclose(program.T_flange_tool, T_FLANGE_TOOL, atol=2e-6)
    for number, point in enumerate(points, 1):
        position = program.positions[number]
        T_base_tool = forward(robot, point.q) @ T_FLANGE_TOOL
        if position.joints is None:
            assert position.T_base_tool is not None
            np.testing.assert_allclose(position.T_base_tool, T_base_tool, atol=2e-6)
        else:
            np.testing.assert_allclose(position.joints, point.q, atol=2e-6)
    kinds = ["joint" if program.positions[n].joints is not None else "cartesian" for n in range(1, 6)]
    assert kinds == ["joint", "joint", "cartesian", "cartesian", "joint"]  # the last has J6 beyond half a turn
    lines = text[text.index("/MN") : text.index("/POS")].splitlines()[1:]
    assert f"LINE_COUNT\t= {len(lines)};" in text
    assert all(line.endswith(";") for line in lines)


def test_the_controller_counts_j3_from_the_horizon_and_its_world_begins_at_j2(robot: RobotModel) -> None:
    """Joint angles printed are the pendant's; heights are less by that of J2, 330 mm."""
    text, _ = written(robot)
    j2, j3 = (np.rad2deg(to_pendant(pick(robot)[1].q))[i] for i in (1, 2))
    assert (j2, j3) == pytest.approx((20.0, -50.0))
    assert "J2=   20.0000 deg,\tJ3=  -50.0000 deg" in text
    z = (forward(robot, pick(robot)[2].q) @ T_FLANGE_TOOL)[2, 3]
    assert f"Z = {1000 * (z - 0.330):9.4f}  mm" in text


def test_a_cartesian_point_and_its_configuration_name_one_branch(robot: RobotModel) -> None:
    """Of all branches that reach the pose without a turn of the wrist, just one has the configuration."""
    rng = np.random.default_rng(0)
    low, high = np.deg2rad([[-150, -60, -60, -150, -110, -150], [150, 100, 150, 150, 110, 150]])
    for q in rng.uniform(low, high, (200, 6)):
        found = inverse(robot, forward(robot, q)[None])
        branches = found.q[0][found.exists[0]]
        branches[:, 3:] = (branches[:, 3:] + np.pi) % (2 * np.pi) - np.pi
        alike = [b for b in branches if configuration(robot, b) == configuration(robot, q)]
        assert len(branches) >= 4 and len(alike) == 1
        np.testing.assert_allclose(alike[0], q, atol=1e-5)


def test_a_flipped_wrist(robot: RobotModel) -> None:
    """As in the maker's examples: J5 negative is N, the same pose with J5 positive and J4, J6 half a turn on is F."""
    q = np.deg2rad([8, -5, -30, 77, -52, -79])
    flipped = q + np.deg2rad([0, 0, 0, -180, 104, 180])
    np.testing.assert_allclose(forward(robot, q), forward(robot, flipped), atol=1e-9)
    assert (configuration(robot, q), configuration(robot, flipped)) == ("N U T", "F U T")


@pytest.mark.parametrize("name", ["", "pick", "7PICK", "PICK-7", "P" * 37])
def test_names_that_a_controller_refuses(robot: RobotModel, name: str) -> None:
    with pytest.raises(InputError, match="--name"):
        write_program(robot, pick(robot), T_FLANGE_TOOL, name)
