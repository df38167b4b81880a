from __future__ import annotations

import numpy as np
import pytest

from cell.frames import Array, rotation_angle
from robots.flight import Ramp, flights, quickest_ramp
from robots.model import RobotModel, forward
from robots.timing import JointPath, Junction, joint_segment, rest_to_rest
from robots.trajectory import Trajectory, joint_move, move_motion, path_motion, tool_line
from tests.robots.arm_cell import DOWN
from tests.robots.test_trajectory import assert_at_rest, assert_keeps_limits, flange, solve

LENGTH = 0.03


def line_at(robot: RobotModel, x: float, y: float, z: float, R: Array = DOWN) -> JointPath:
    """Up from a point."""
    T = flange(x, y, z, R)
    path = tool_line(robot, T, flange(x, y, z + LENGTH, R), solve(robot, T))
    assert isinstance(path, JointPath)
    return path


def ramp_at(robot: RobotModel, x: float, y: float, z: float, landing: bool, limit: float | None = None) -> Ramp:
    return quickest_ramp(robot, line_at(robot, x, y, z), LENGTH, landing, limit)


def test_a_flight_between_lines_is_smooth_and_quicker_than_stopping(robot: RobotModel) -> None:
    start, end = ramp_at(robot, 0.25, -0.4, 0.06, False), ramp_at(robot, 0.45, 0.05, 0.03, True)
    stops = sum(path_motion(robot, ramp.path).duration for ramp in (start, end))
    stops += move_motion(robot, start.path.end, end.path.end).duration
    motions = list(flights(robot, start, end))
    assert motions
    for motion in motions:
        trajectory = Trajectory("fly", *motion.sampled(1 / 480), 1 / 480)
        assert_keeps_limits(robot, trajectory)
        assert_at_rest(trajectory)
        np.testing.assert_allclose(trajectory.q[[0, -1]], [start.path.start, end.path.start], atol=1e-9)
        assert motion.duration < 0.9 * stops


@pytest.mark.parametrize("landing", [False, True])
def test_a_ramp_is_straight_from_rest_to_flight(robot: RobotModel, landing: bool) -> None:
    ramp = ramp_at(robot, 0.45, 0.05, 0.03, landing)
    q, _ = ramp.at(np.linspace(0.0, ramp.duration, 50))
    Ts = forward(robot, q[::-1] if landing else q)
    assert np.abs(Ts[:, :2, 3] - Ts[0, :2, 3]).max() < 0.05e-3
    assert Ts[-1, 2, 3] - Ts[0, 2, 3] == pytest.approx(LENGTH, abs=1e-6)
    assert (np.diff(Ts[:, 2, 3]) >= 0).all()
    assert rotation_angle(np.swapaxes(Ts[:, :3, :3], 1, 2) @ Ts[0, :3, :3]).max() < 1e-4


def test_a_junction_is_what_finite_differences_say(robot: RobotModel) -> None:
    for landing in (False, True):
        ramp = ramp_at(robot, 0.45, 0.05, 0.03, landing)
        h = 1e-4
        times = ramp.duration - h * np.array([2.0, 1.0, 0.0])
        q = ramp.at(ramp.duration - times if landing else times)[0]
        junction = ramp.junction
        np.testing.assert_allclose(q[2], junction.q, atol=1e-12)
        velocity = (3 * q[2] - 4 * q[1] + q[0]) / (2 * h)
        np.testing.assert_allclose(-velocity if landing else velocity, junction.velocity, atol=1e-4)
        np.testing.assert_allclose((q[2] - 2 * q[1] + q[0]) / h**2, junction.acceleration, atol=0.2)


def test_a_ramp_with_a_limit_keeps_it(robot: RobotModel) -> None:
    for limit in (4.0, 12.0):
        ramp = ramp_at(robot, 0.45, 0.05, 0.03, False, limit)
        q = ramp.at(np.arange(0.0, ramp.duration, 0.002))[0]
        z = forward(robot, q)[:, 2, 3]
        assert np.diff(z, 2).max() / 0.002**2 <= 1.01 * limit


def test_rest_to_rest_is_what_ruckig_finds(robot: RobotModel) -> None:
    turned = np.random.default_rng(0).uniform(-2, 2, (200, 6)) * np.logspace(-4, 0, 200)[:, None]
    for d, seconds in zip(turned, rest_to_rest(robot, turned), strict=True):
        assert joint_move(robot, robot.home * 0, d * 0.5).duration <= seconds + 1 / 480
        found = joint_segment(robot, Junction.at_rest(np.zeros(6)), Junction.at_rest(d))
        assert found is not None
        assert found.duration == pytest.approx(seconds, abs=1e-9)


def test_profiles_are_evaluated_as_ruckig_does(robot: RobotModel) -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        ends = [
            Junction(q, v * robot.velocity, a * robot.acceleration)
            for q, v, a in zip(*(rng.uniform(-1, 1, (2, 6)) * s for s in (1.0, 0.4, 0.8)), strict=True)
        ]
        segment = joint_segment(robot, *ends)
        if segment is None:
            continue
        times = np.linspace(0.0, segment.duration, 40)
        q, qd = segment.at(times)
        states = [segment.profile.at_time(t) for t in times]
        np.testing.assert_allclose(q, [s[0] for s in states], atol=1e-12)
        np.testing.assert_allclose(qd, [s[1] for s in states], atol=1e-11)
