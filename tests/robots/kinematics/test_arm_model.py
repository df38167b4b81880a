from __future__ import annotations

import numpy as np
import pytest

from pickproof.cell.errors import InputError
from pickproof.cell.frames import make_transform
from pickproof.robots.kinematics.model import RobotModel, forward, from_pendant, list_robots, load_robot, to_pendant


def test_data_sheet_limits_in_degrees(robot: RobotModel) -> None:
    np.testing.assert_allclose(np.rad2deg(robot.lower), [-170, -100, -70, -190, -125, -360], atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(robot.upper), [170, 145, 205, 190, 125, 360], atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(robot.velocity), [450, 380, 520, 550, 545, 1000])
    assert robot.within_limits(robot.home, margin=0.1)
    np.testing.assert_allclose(robot.kinematics.velocityLimit, robot.velocity)


def test_flange_at_zero_looks_forward(robot: RobotModel) -> None:
    T = forward(robot, np.zeros(6))
    np.testing.assert_allclose(T[:3, 3], [0.05 + 0.335 + 0.08, 0, 0.33 + 0.33 + 0.035], atol=1e-12)
    np.testing.assert_allclose(T[:3, 2], [1, 0, 0], atol=1e-12)


def test_reach_is_the_data_sheets(robot: RobotModel) -> None:
    stretched = np.arctan2(0.035, 0.335)  # forearm in line with the upper arm, both horizontal
    wrist = forward(robot, np.array([0, np.pi / 2, np.pi / 2 - stretched, 0, 0, 0])) @ make_transform(t=(0, 0, -0.08))
    assert np.hypot(wrist[0, 3], wrist[1, 3]) == pytest.approx(robot.reach, abs=1e-3)


def test_home_holds_the_tool_straight_down(robot: RobotModel) -> None:
    np.testing.assert_allclose(forward(robot, robot.home)[:3, 2], [0, 0, -1], atol=1e-12)


def test_pendant_coupling(robot: RobotModel) -> None:
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (50, 6))
    np.testing.assert_allclose(to_pendant(from_pendant(q)), q, atol=1e-15)
    # Moving only J2 on the pendant keeps the forearm's slope, so the flange's orientation stays as it is.
    pendant = np.array([0.2, 0.1, -0.3, 0.4, -0.5, 0.6])
    moved = pendant + np.array([0, 0.3, 0, 0, 0, 0])
    a, b = forward(robot, from_pendant(np.stack([pendant, moved])))
    np.testing.assert_allclose(a[:3, :3], b[:3, :3], atol=1e-12)


def test_unknown_robot_names_the_known() -> None:
    known = ", ".join(list_robots())
    assert "lrmate200id" in known
    with pytest.raises(InputError, match=rf"robot: 'arm' is not valid; expected one of: {known}"):
        load_robot("arm")
