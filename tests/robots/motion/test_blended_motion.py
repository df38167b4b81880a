from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from pickproof.cell.frames import Array, apply, rotation_angle
from pickproof.robots.kinematics.inverse import flange_poses
from pickproof.robots.kinematics.model import RobotModel, forward
from pickproof.robots.motion.blended_motion import OFF_LINE, Between, End, Form
from pickproof.robots.motion.s_curve import rise, s_curve, when
from pickproof.robots.motion.timing import JointPath, Motion, joint_segment, rest_to_rest
from pickproof.robots.motion.trajectory import Trajectory, joint_move, move_motion, path_motion, tool_line
from tests.robots.arm_cell import DOWN, T_FLANGE_TOOL
from tests.robots.motion.test_trajectory import assert_at_rest, assert_keeps_limits, flange, solve

LENGTH, STRAIGHT = 0.08, 0.02
CORNERS = np.array([[0.0, 0.0, 0.0], [0.03, 0.03, 0.17], [-0.03, -0.03, 0.17]])
ROUND, SHARP, HIGH = Form((0.0, 0.0), np.zeros(6)), Form((1.0, 1.0), np.zeros(6)), 0.1


def end_at(robot: RobotModel, x: float, y: float, z: float, R: Array = DOWN) -> End:
    """With a line up from a point."""
    T = flange(x, y, z, R)
    path = tool_line(robot, T, flange(x, y, z + LENGTH, R), solve(robot, T))
    assert isinstance(path, JointPath)
    return End(path.start, path, LENGTH, STRAIGHT)


def between(robot: RobotModel, limit: float | None = None) -> Between:
    start, end = end_at(robot, 0.25, -0.4, 0.06), end_at(robot, 0.45, 0.05, 0.03)
    return Between(robot, start, end, T_FLANGE_TOOL, CORNERS, limit)


def forms(robot: RobotModel) -> list[Form]:
    (high,) = between(robot).raised(np.array([HIGH]))
    assert high is not None
    return [ROUND, SHARP, Form((0.1, 0.6), high)]


def flown(robot: RobotModel, form: Form, limit: float | None = None, speed: float = 1.0) -> Trajectory:
    b = between(robot, limit)
    seconds, blend = b.quickest(form, speed)
    motion, scale = Motion((blend,), b.end.q), b.scale(blend, speed)
    trajectory = Trajectory("fly", *motion.sampled(1 / 480, scale), 1 / 480)
    assert trajectory.duration == pytest.approx(seconds, rel=0.1)
    return trajectory


def test_blended_motions_are_smooth_within_limits_and_quicker_than_stopping(robot: RobotModel) -> None:
    b = between(robot)
    assert b.start.path is not None and b.end.path is not None
    stops = sum(path_motion(robot, end.path).duration for end in (b.start, b.end) if end.path)
    stops += move_motion(robot, b.start.far, b.end.far).duration
    for form in forms(robot):
        trajectory = flown(robot, form)
        assert_keeps_limits(robot, trajectory)
        assert_at_rest(trajectory)
        np.testing.assert_allclose(trajectory.q[[0, -1]], [b.start.q, b.end.q], atol=1e-9)
    assert flown(robot, ROUND).duration < 0.65 * stops
    assert flown(robot, ROUND).duration > rest_to_rest(robot, b.end.q - b.start.q)


def test_half_the_speed_is_twice_the_time_along_the_same_way(robot: RobotModel) -> None:
    full, half = flown(robot, ROUND), flown(robot, ROUND, speed=0.5)
    assert half.duration == pytest.approx(2 * full.duration, abs=3 / 480)
    np.testing.assert_allclose(half.q[::2][: len(full.q) - 1], full.q[:-1], atol=1e-9)


def test_what_must_be_straight_is_straight(robot: RobotModel) -> None:
    """No corner of the hand leaves the line by more than OFF_LINE, and the hand does not turn, at either end."""
    for form in forms(robot):
        q = flown(robot, form).q
        for rows in (q, q[::-1]):
            moved = apply(flange_poses(robot, rows), CORNERS)
            moved = moved - moved[0]
            near = np.abs(moved[:, 0, 2]) < STRAIGHT
            stretch = moved[: int(np.argmin(near))]
            assert len(stretch) > 10
            assert np.linalg.norm(stretch[..., :2], axis=-1).max() < 1.1 * OFF_LINE
            Ts = forward(robot, rows[: len(stretch)])
            assert rotation_angle(np.swapaxes(Ts[:, :3, :3], 1, 2) @ Ts[0, :3, :3]).max() < 0.01


def test_a_raised_way_is_higher_in_the_middle(robot: RobotModel) -> None:
    high = [(forward(robot, flown(robot, form).q) @ T_FLANGE_TOOL)[:, 2, 3] for form in forms(robot)]
    assert high[2][len(high[2]) // 2] > high[1][len(high[1]) // 2] + 0.5 * HIGH


def test_the_tools_acceleration_keeps_its_limit(robot: RobotModel) -> None:
    for limit in (4.0, 12.0):
        for form in forms(robot):
            q = flown(robot, form, limit).q
            points = (forward(robot, q) @ T_FLANGE_TOOL)[:-1, :3, 3]
            shaken = np.linalg.norm(np.diff(points, 2, axis=0), axis=1).max() * 480**2
            assert shaken <= 1.02 * limit
            assert limit > 4.0 or shaken > 0.85 * limit


def test_profiles_are_as_quick_as_ruckigs_and_keep_their_limits(robot: RobotModel) -> None:
    """From rest to rest on one axis, against an arm whose first joint has these limits."""
    rng = np.random.default_rng(0)
    v, a, j = (10 ** rng.uniform(-1, 2, 200) for _ in range(3))
    one = np.ones(6)
    for k in range(200):
        profile, soft = s_curve(v[k], a[k], j[k]), rise(a[k], j[k], rng.uniform(0.1, 0.6))
        limits = {"velocity": one * v[k], "acceleration": one * a[k], "jerk": one * j[k]}
        arm = type("Arm", (), limits)
        found = joint_segment(arm, np.zeros(6), one)  # type: ignore[arg-type]
        assert profile.duration == pytest.approx(found.duration, rel=1e-9)
        for each in (profile, soft):
            times = np.linspace(-0.1, 1.1, 1001) * each.duration
            s = each.at(times)
            assert s[0].min() == 0.0 and s[0].max() == pytest.approx(1.0) and (np.diff(s[0]) >= -1e-12).all()
            for lower, upper in pairwise(s[:3]):
                slope = np.diff(lower) / (times[1] - times[0])
                assert (slope <= np.maximum(upper[1:], upper[:-1]) + 0.05 * np.abs(upper).max()).all()
            assert each.at(np.array([when(each.table, 0.3)]))[0, 0] == pytest.approx(0.3, abs=1e-6)
        s = profile.at(np.linspace(0.0, 1.0, 1001) * profile.duration)
        for derivative, limit in zip(s[1:], (v[k], a[k], j[k]), strict=True):
            assert np.abs(derivative).max() <= limit * (1 + 1e-9)


def test_rest_to_rest_is_what_ruckig_finds(robot: RobotModel) -> None:
    turned = np.random.default_rng(0).uniform(-2, 2, (200, 6)) * np.logspace(-4, 0, 200)[:, None]
    for d, seconds in zip(turned, rest_to_rest(robot, turned), strict=True):
        assert joint_move(robot, robot.home * 0, d * 0.5).duration <= seconds + 1 / 480
        found = joint_segment(robot, np.zeros(6), d)
        assert found.duration == pytest.approx(seconds, abs=1e-9)
        times = np.linspace(0.0, found.duration, 20)
        q, qd = found.at(times)
        states = [found.profile.at_time(t) for t in times]
        np.testing.assert_allclose(q, [s[0] for s in states], atol=1e-12)
        np.testing.assert_allclose(qd, [s[1] for s in states], atol=1e-11)
