from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from pickproof.cell.frames import Array, about_axis, invert, make_transform, rotation_angle
from pickproof.robots.failure import Cause, Refusal
from pickproof.robots.kinematics.inverse import inverse
from pickproof.robots.kinematics.model import RobotModel, forward
from pickproof.robots.motion.timing import JointPath
from pickproof.robots.motion.trajectory import (
    Trajectory,
    concatenate,
    follow,
    gentle_scale,
    joint_move,
    joint_path,
    linear_move,
    move_motion,
    tool_acceleration,
    tool_line,
)
from tests.robots.arm_cell import DOWN, T_FLANGE_TOOL, tilted


def flange(x: float, y: float, z: float, R: Array = DOWN) -> Array:
    return make_transform(R, (x, y, z)) @ invert(T_FLANGE_TOOL)


def solve(robot: RobotModel, T: Array) -> Array:
    return inverse(robot, T[None], robot.home).q[0, 0]


def assert_keeps_limits(robot: RobotModel, trajectory: Trajectory) -> None:
    """Every sample and every finite difference; differences lie inside the limits by the mean value theorem."""
    assert robot.within_limits(trajectory.q).all()
    velocity = np.diff(trajectory.q, axis=0) / trajectory.dt
    acceleration = np.diff(velocity, axis=0) / trajectory.dt
    jerk = np.diff(acceleration, axis=0) / trajectory.dt
    assert (np.abs(velocity) / robot.velocity).max() <= 1 + 1e-9
    assert (np.abs(acceleration) / robot.acceleration).max() <= 1 + 1e-6
    assert (np.abs(jerk) / robot.jerk).max() <= 1 + 1e-3
    assert (np.abs(trajectory.qd) / robot.velocity).max() <= 1 + 1e-9
    # q and qd tell the same story: central differences err by jerk * dt^2 / 6 at most
    middle = (trajectory.q[2:] - trajectory.q[:-2]) / (2 * trajectory.dt)
    error = np.abs(middle - trajectory.qd[1:-1])[:-1]  # the last step is shorter than dt
    assert (error <= robot.jerk * trajectory.dt**2 / 6 * 1.01 + 1e-9).all()


def assert_at_rest(trajectory: Trajectory) -> None:
    assert np.abs(trajectory.qd[[0, -1]]).max() < 1e-9


def test_joint_moves_keep_limits_and_start_and_end_at_rest(robot: RobotModel) -> None:
    ends = np.random.default_rng(0).uniform(robot.lower, robot.upper, (20, 2, 6))
    for q0, q1 in ends:
        move = joint_move(robot, q0, q1)
        assert_keeps_limits(robot, move)
        assert_at_rest(move)
        np.testing.assert_allclose(move.q[[0, -1]], [q0, q1], atol=1e-12)
        along = (move.q - q0) / (q1 - q0)  # straight in joint space: all joints are equally far
        assert np.ptp(along, axis=1).max() < 1e-6


def test_scale_slows_down_in_time_only(robot: RobotModel) -> None:
    q1 = robot.home + 0.5
    full, half = joint_move(robot, robot.home, q1), joint_move(robot, robot.home, q1, scale=0.5)
    assert half.duration == pytest.approx(2 * full.duration, abs=3 * full.dt)
    np.testing.assert_allclose(half.q[::2][: len(full.q) - 1], full.q[:-1], atol=1e-9)


def test_a_start_outside_the_limits_is_refused(robot: RobotModel) -> None:
    for bad in (robot.upper + 0.1, np.full(6, np.nan)):
        with pytest.raises(ValueError, match="outside the joint limits of lrmate200id"):
            joint_move(robot, bad, robot.home)


@pytest.mark.parametrize("R", [DOWN, tilted(30, 40, 70), tilted(45, 200, 10)])
def test_the_tool_line_is_straight(robot: RobotModel, R: Array) -> None:
    T0, T1 = flange(0.42, 0.05, 0.20, R), flange(0.45, 0.03, 0.04, R)
    move = linear_move(robot, T0, T1, solve(robot, T0))
    assert move is not None
    assert_keeps_limits(robot, move)
    assert_at_rest(move)
    Ts = forward(robot, move.q)
    direction = (T1 - T0)[:3, 3] / np.linalg.norm((T1 - T0)[:3, 3])
    off = Ts[:, :3, 3] - T0[:3, 3]
    along = off @ direction
    assert np.linalg.norm(off - along[:, None] * direction, axis=1).max() < 0.2e-3
    assert (np.diff(along) > -1e-9).all()
    assert rotation_angle(np.swapaxes(Ts[:, :3, :3], 1, 2) @ T0[:3, :3]).max() < 1e-3
    np.testing.assert_allclose(Ts[-1], T1, atol=1e-9)


def test_a_line_that_leaves_the_workspace_is_told(robot: RobotModel) -> None:
    T0 = flange(0.45, 0.0, 0.2)
    q0 = solve(robot, T0)
    assert tool_line(robot, T0, flange(0.95, 0.0, 0.2), q0) == Refusal(Cause.OUT_OF_REACH)
    assert linear_move(robot, T0, flange(0.95, 0.0, 0.2), q0) is None
    turned = inverse(robot, T0[None], q0 + np.array([0, 0, 0, 0, 0, 2 * np.pi])).q[0, 0]  # J6 at its limit
    either_way = [tool_line(robot, T0, T0 @ about_axis((0, 0, 1), a), turned) for a in (3.0, -3.0)]
    assert sorted(isinstance(line, JointPath) for line in either_way) == [False, True]
    assert Refusal(Cause.JOINT_LIMIT, joint=6) in either_way


def test_gentle_scale_bounds_the_tools_acceleration(robot: RobotModel) -> None:
    motion = move_motion(robot, robot.home, solve(robot, flange(0.45, 0, 0.15)))
    assert tool_acceleration(robot, motion, T_FLANGE_TOOL) > 5.0
    scale = gentle_scale(robot, motion, T_FLANGE_TOOL, 5.0)
    q, _ = motion.sampled(1 / 480, scale)
    points = (forward(robot, q) @ T_FLANGE_TOOL)[:-1, :3, 3]
    assert np.linalg.norm(np.diff(points, 2, axis=0) * 480**2, axis=1).max() <= 5.0


def test_concatenate(robot: RobotModel) -> None:
    a, b = robot.home, robot.home + 0.3
    there, back = joint_move(robot, a, b), joint_move(robot, b, a)
    both = concatenate("both", [there, back])
    assert both.duration == pytest.approx(there.duration + back.duration)
    np.testing.assert_array_equal(both.q, joint_path(robot, [a, b, a]).q)
    with pytest.raises(ValueError, match="does not start where"):
        concatenate("jump", [there, there])


def test_handed_on_arrays_are_read_only(robot: RobotModel) -> None:
    with pytest.raises(ValueError, match="read-only"):
        joint_move(robot, robot.home, robot.home + 0.1).q[0, 0] = 1.0


def test_a_sharply_bent_path_still_has_a_time_law(robot: RobotModel) -> None:
    s = np.linspace(0, 1, 33)
    q = robot.home + 0.3 * np.tanh(60 * (s[:, None] - 0.5))
    bent = follow(robot, JointPath(CubicSpline(s, q, axis=0)))
    assert_keeps_limits(robot, bent)
    assert_at_rest(bent)
