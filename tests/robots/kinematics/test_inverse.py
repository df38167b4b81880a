from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pickproof.cell.frames import make_transform
from pickproof.robots.kinematics.inverse import FRONT, branch, flange_poses, inverse, reachable
from pickproof.robots.kinematics.model import RobotModel, forward, list_robots, load_robot
from tests.robots.arm_cell import DOWN, PLACE, SOURCE, T_FLANGE_TOOL, tilted

pytestmark = pytest.mark.slow


def random_q(robot: RobotModel, n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(robot.lower, robot.upper, (n, 6))


@pytest.mark.parametrize("name", list_robots())
def test_closed_form_is_numeric_kinematics_on_100_000_poses(name: str) -> None:
    """Of every shipped robot: the pose by Pinocchio from the URDF, the joints by the closed form, and back."""
    robot = load_robot(name)
    q = random_q(robot, 100_000)
    Ts = forward(robot, q)
    assert np.abs(flange_poses(robot, q) - Ts).max() < 1e-11
    found, slot = inverse(robot, Ts, robot.home), branch(robot, q)
    mine, at = found.q[np.arange(len(q)), slot], found.sigma[np.arange(len(q)), slot]
    assert np.abs(flange_poses(robot, mine) - Ts).max() < 1e-9
    assert found.valid[np.arange(len(q)), slot].mean() > 0.9999
    clear = at > 1e-3
    assert clear.mean() > 0.98
    turns = (mine - q)[clear] / (2 * np.pi)
    assert np.abs(turns - np.round(turns)).max() < 1e-8


@pytest.mark.parametrize("name", list_robots())
def test_the_reach_is_the_data_sheets(name: str) -> None:
    robot = load_robot(name)
    o = robot.opw
    assert o.a1 + o.c2 + np.hypot(o.a2, o.c3) == pytest.approx(robot.reach, abs=1e-3)
    np.testing.assert_allclose(robot.kinematics.velocityLimit, robot.velocity)
    assert robot.within_limits(robot.home, margin=0.1)


def test_every_branch_leads_back_to_its_pose(robot: RobotModel) -> None:
    Ts = forward(robot, random_q(robot, 3000))
    found = inverse(robot, Ts)
    back = forward(robot, found.q[found.exists])
    np.testing.assert_allclose(back, np.repeat(Ts, found.exists.sum(axis=1), axis=0), atol=1e-9)


def test_the_joints_come_back_in_their_branch(robot: RobotModel) -> None:
    q = random_q(robot, 3000)
    found, slot = inverse(robot, forward(robot, q)), branch(robot, q)
    assert found.valid[np.arange(len(q)), slot].all()
    turns = (found.q[np.arange(len(q)), slot] - q) / (2 * np.pi)
    clear = found.sigma[np.arange(len(q)), slot] > 1e-4
    assert np.abs(turns - np.round(turns))[clear].max() < 1e-9


def test_branch_numbers_are_the_slots(robot: RobotModel) -> None:
    found = inverse(robot, forward(robot, random_q(robot, 500)))
    numbers = np.broadcast_to(np.arange(8), found.exists.shape)
    np.testing.assert_array_equal(branch(robot, found.q[found.exists]), numbers[found.exists])


def test_limits_and_nearest_turn(robot: RobotModel) -> None:
    q = random_q(robot, 500)
    found = inverse(robot, forward(robot, q))
    assert robot.within_limits(found.q[found.valid]).all()
    for k in range(50):  # the configuration itself is the nearest to itself, also beyond half a turn
        near = inverse(robot, forward(robot, q[k])[None], q[k])
        np.testing.assert_allclose(near.q[0, branch(robot, q[k])], q[k], atol=1e-6)


def test_opw_forward_is_pinocchios(robot: RobotModel) -> None:
    q = random_q(robot, 500)
    np.testing.assert_allclose(flange_poses(robot, q), forward(robot, q), atol=1e-12)


def test_sigma_is_that_of_pinocchios_jacobian(robot: RobotModel) -> None:
    data = robot.kinematics.createData()
    q = random_q(robot, 50)
    found = inverse(robot, forward(robot, q))
    for k in range(len(q)):
        J = pin.computeFrameJacobian(robot.kinematics, data, q[k], robot.flange, pin.LOCAL_WORLD_ALIGNED)
        sigma = np.linalg.svd(J, compute_uv=False)[-1]
        np.testing.assert_allclose(found.sigma[k, branch(robot, q[k])], sigma, atol=1e-9)


def test_out_of_reach_and_behind(robot: RobotModel) -> None:
    Ts = make_transform(DOWN, np.array([[0.45, 0, 0.1], [1.2, 0, 0.1], [-0.45, 0, 0.1]]))
    mask, sigma = reachable(robot, Ts, T_FLANGE_TOOL)
    assert mask.tolist() == [True, False, False]
    assert sigma[1] == 0
    assert not inverse(robot, Ts[1:2]).exists.any()


def test_both_bins_are_within_reach(robot: RobotModel) -> None:
    rng = np.random.default_rng(1)
    for tilt, share in ((0, 1.0), (30, 0.9), (45, 0.8)):
        for place in (SOURCE, PLACE):
            points = np.array(place.position) + rng.uniform([-0.13, -0.10, 0], [0.13, 0.10, 0.2], (200, 3))
            R = np.stack([tilted(tilt, *rng.uniform(0, 360, 2)) for _ in points])
            mask, _ = reachable(robot, make_transform(R, points), T_FLANGE_TOOL)
            assert mask.mean() >= share


def test_front_branches_face_the_work(robot: RobotModel) -> None:
    found = inverse(robot, make_transform(DOWN, [[0.45, 0.1, 0.3]]))
    for slot in FRONT:
        if found.exists[0, slot]:
            assert abs(found.q[0, slot, 0]) < np.pi / 2
