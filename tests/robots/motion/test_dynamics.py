from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from pickproof.cell.errors import InputError
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.robots.kinematics.model import forward, list_robots, load_robot
from pickproof.robots.motion.dynamics import Load, overload, torques
from pickproof.robots.motion.trajectory import Trajectory, joint_move
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.picking.workcell import check_payload
from tests.robots.arm_cell import share_of_limits

NAMES = list_robots()


@pytest.mark.parametrize("name", NAMES)
def test_at_rest_torques_are_the_gradient_of_the_potential_energy(name: str) -> None:
    robot, load = load_robot(name), Load(3.0, np.array([0.02, 0.0, 0.1]))
    q = np.random.default_rng(0).uniform(-1, 1, 6)

    def energy(q: np.ndarray) -> float:
        data = robot.kinematics.createData()
        arm = pin.computePotentialEnergy(robot.kinematics, data, q)
        T = forward(robot, q)
        return float(arm + load.mass * 9.81 * (T[:3, :3] @ load.centre + T[:3, 3])[2])

    still = Trajectory("still", np.tile(q, (3, 1)), np.zeros((3, 6)), 0.01)
    h = 1e-6
    gradient = [(energy(q + h * e) - energy(q - h * e)) / (2 * h) for e in np.eye(6)]
    np.testing.assert_allclose(torques(robot, still, load)[0], gradient, atol=1e-5)


def test_power_is_the_change_of_energy() -> None:
    """Torque times speed over a whole move from rest to rest lifts the arm and nothing else."""
    robot = load_robot("m20id25")
    move = joint_move(robot, robot.home, robot.home + np.array([1.0, -0.4, 0.3, 0.5, 0.2, 1.0]), dt=1e-3)
    work = (torques(robot, move) * move.qd[1:-1]).sum() * move.dt
    data = robot.kinematics.createData()
    lifted = [pin.computePotentialEnergy(robot.kinematics, data, q) for q in (move.q[-1], move.q[0])]
    assert work == pytest.approx(lifted[0] - lifted[1], rel=0.01)


@pytest.mark.parametrize("name", NAMES)
def test_full_speed_moves_keep_the_torque_limits_with_the_payload(name: str) -> None:
    robot = load_robot(name)
    load = Load(robot.payload, np.array([0.0, 0.0, 0.05]))
    rng = np.random.default_rng(1)
    for _ in range(5):
        turn = rng.uniform(-1, 1, 6) * (1.0, 0.4, 0.4, 1.0, 0.5, 2.0)
        share = share_of_limits(robot, joint_move(robot, robot.home, robot.home + turn), load)
        assert (share < 1.0).all()
    heavy = Load(40 * robot.payload, load.centre)
    assert (share_of_limits(robot, joint_move(robot, robot.home, robot.home + 0.4), heavy) > 1.0).any()


def test_the_payload_is_checked() -> None:
    robot = load_robot("lrmate200id")
    assert overload(robot, Load(7.0, np.zeros(3))) == ""
    assert overload(robot, Load(7.5, np.zeros(3))) == "7.5 kg exceeds the payload of 7.0 kg"


def test_what_the_arm_may_not_carry_is_one_line_before_anything_moves() -> None:
    scenario = load_scenario("bracket", ["workpiece=gear_shaft", "gripper=jaw_v_shaft"])
    gripper, shaft = load_gripper("jaw_v_shaft"), load_workpiece("gear_shaft")
    robot = load_robot("lrmate200id")
    check_payload(scenario, robot, gripper, shaft)
    weak = replace(robot, payload=5.0)
    with pytest.raises(InputError) as told:
        check_payload(scenario, weak, gripper, shaft)
    assert str(told.value).count("\n") == 0
    assert told.value.field == "workpiece" and "gear_shaft, 3.89 kg" in str(told.value.value)
    assert told.value.valid == "at most 5.0 kg in total, the payload of lrmate200id"
