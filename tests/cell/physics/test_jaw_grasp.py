"""A part is held by contact and friction alone: carried fast it stays, without friction it falls."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from pickproof.cell.errors import SimulationError
from pickproof.cell.frames import make_transform
from pickproof.cell.physics.observation import observe
from pickproof.cell.physics.trajectory_execution import close_jaws, execute, finger_forces, held_parts, open_jaws, wait
from tests.cell.physics.grasp_cell import PLACE, R_DOWN, GraspCell

OVER_PLACE = make_transform(R_DOWN, (*PLACE.position[:2], 0.2))


@pytest.fixture
def cell() -> Iterator[GraspCell]:
    built = GraspCell.build()
    yield built
    built.world.close()


def pick(cell: GraspCell) -> None:
    above = cell.above()
    log = cell.line(cell.grasp(), 15.0)
    assert log.max_force == 0.0 and not log.touched
    close_jaws(cell.world, cell.arm)
    cell.mark()
    cell.line(above, 15.0)


def test_picked_carried_fast_and_placed(cell: GraspCell) -> None:
    before = observe(cell.world, [PLACE])
    pick(cell)
    assert held_parts(cell.world, cell.arm) == (0,)
    log = cell.line(OVER_PLACE, 15.0)
    for T in (make_transform(t=(0.1, 0.0, 0.0)), make_transform(t=(0.0, -0.2, 0.0)), np.eye(4)):
        log += cell.line(T @ OVER_PLACE, 15.0)
    assert held_parts(cell.world, cell.arm) == (0,)
    assert cell.slip < 5e-4 and cell.slip_deg < 0.5
    assert log.max_error < 1e-3
    assert cell.world.client.getNumConstraints() == 1  # the gear of the fingers; nothing holds the part
    released = open_jaws(cell.world, cell.arm, 0.05)
    assert released.parts == () and released.opening == pytest.approx(0.05, abs=5e-4)
    assert cell.world.run_until_rest(3.0)
    after = observe(cell.world, [PLACE])
    assert before.parts_in("place") == () and after.parts_in("place") == (0,) and after.at_rest.all()
    assert after.moved(before)[0] > 0.4


def test_the_pads_press_with_the_force_of_the_data_sheet(cell: GraspCell) -> None:
    cell.line(cell.grasp(), 5.0)
    jaws = close_jaws(cell.world, cell.arm)
    assert jaws.parts == (0,)
    assert jaws.opening == pytest.approx(0.018, abs=3e-4)
    wait(cell.world, cell.arm, 0.1)
    np.testing.assert_allclose(finger_forces(cell.world, cell.arm), cell.arm.gripper.force, rtol=0.1)


@pytest.mark.parametrize(
    ("friction", "force", "holds"),
    [(0.02, 10.0, False), (0.005, 40.0, False), (0.5, 0.4, False), (0.02, 40.0, True), (0.1, 10.0, True)],
)
def test_it_holds_when_friction_carries_the_weight(friction: float, force: float, holds: bool) -> None:
    """Coulomb: 2 mu F against m (g + a) = 0.048 kg x 12.8 m/s2 = 0.6 N; the three that drop it give 0.4 N."""
    cell = GraspCell.build(friction=friction, pad_friction=friction, force=force)
    cell.line(cell.grasp(), 5.0)
    close_jaws(cell.world, cell.arm)
    cell.line(cell.above(), 3.0)
    assert (held_parts(cell.world, cell.arm) == (0,)) == holds
    assert (cell.world.part_pose(0)[2, 3] > 0.05) == holds
    cell.world.close()


def test_closing_on_nothing_is_seen(cell: GraspCell) -> None:
    jaws = close_jaws(cell.world, cell.arm)
    assert jaws.parts == () and jaws.opening == pytest.approx(0.0, abs=3e-4)


def test_a_hard_touch_is_measured_and_stops_the_arm(cell: GraspCell) -> None:
    """The rail of the gripper, wider than the fingers, is driven against a bin wall."""
    start = make_transform(R_DOWN, (PLACE.position[0], PLACE.position[1], 0.03))
    cell.arm.reset(cell.solve(start[None])[0])
    log = cell.line(start, 5.0)
    assert log.max_force == 0.0
    target = make_transform(t=(0.0, -0.13, 0.0)) @ start
    q = cell.solve(make_transform(R_DOWN, np.linspace(start[:3, 3], target[:3, 3], 200)))
    log = execute(cell.world, cell.arm, q, stop_above=100.0)
    assert log.stopped and log.max_force > 100.0
    assert log.max_force_against == "place_wall_y0" and log.max_force_link == "gripper_body"
    assert "place_wall_y0" in log.touched


def test_a_finger_on_the_table_is_not_a_collision_but_is_seen(cell: GraspCell) -> None:
    T = cell.arm.tool_pose()
    T[:2, 3] += 0.05
    cell.arm.reset(cell.solve(T[None])[0])
    T[2, 3] = -0.0003
    log = cell.line(T, 5.0)
    assert log.max_finger_force > 10.0
    assert log.max_force == 0.0 and not log.touched


def test_an_arm_that_is_held_back_gives_up(cell: GraspCell) -> None:
    T = cell.arm.tool_pose()
    T[:2, 3] += 0.05
    cell.arm.reset(cell.solve(T[None])[0])
    deep = make_transform(t=(0.0, 0.0, -T[2, 3] - 0.05)) @ T
    q = cell.solve(make_transform(R_DOWN, np.linspace(T[:3, 3], deep[:3, 3], 300)))
    log = execute(cell.world, cell.arm, q)
    assert log.stopped and log.time < 300 * cell.world.dt
    assert 100.0 < log.max_finger_force < 2500.0  # what the joints' torques can press
    assert cell.arm.tool_pose()[2, 3] > -0.002


def test_a_target_that_is_not_a_number_is_refused(cell: GraspCell) -> None:
    q = cell.arm.q
    with pytest.raises(SimulationError, match="finite"):
        execute(cell.world, cell.arm, np.full((1, 6), np.nan))
    wait(cell.world, cell.arm, 0.02)
    np.testing.assert_allclose(cell.arm.q, q, atol=1e-4)


def test_forward_kinematics_of_both_models_agree(cell: GraspCell) -> None:
    from pickproof.robots.kinematics.model import forward

    for q in np.random.default_rng(0).uniform(-1.0, 1.0, (5, 6)):
        cell.arm.reset(q)
        expected = forward(cell.robot, q) @ cell.arm.gripper.T_flange_tool
        np.testing.assert_allclose(cell.arm.tool_pose(), expected, atol=1e-6)
