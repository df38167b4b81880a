"""What swings on the gripper weighs what it weighs, and two weigh twice: closed form and physics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pickproof.cell.frames import Array, about_axis, make_transform
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.floating_gripper import floating_arm, floating_joints
from pickproof.cell.physics.force_torque_sensor import PATIENCE, QUIET, weigh, weigh_swinging, whole_periods
from pickproof.cell.physics.trajectory_execution import close_jaws
from pickproof.cell.physics.world import GRAVITY, World
from pickproof.cell.workpiece.workpiece import load_workpiece

DT = 1 / 480
LENGTH = 0.066  # [m] from the top of the ring to the centre of mass
MASS = load_workpiece("ring_screw").mass
WIRE_TOP = 0.0645  # [m] from the eye bolt's origin to the middle of its wire at the top
DOWN = np.diag([1.0, -1.0, -1.0])
RING_UP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""R_tool_bolt of an eye bolt that hangs on its ring, the ring's plane across the closing direction."""


def pendulum(swing_deg: float, seconds: float, phase: float) -> Array:
    """Vertical force (n,) of a pendulum on its pivot: rod force m (g cos a + l a'^2), with a'' = -g/l sin a."""
    start = np.array([np.deg2rad(swing_deg), 0.0])
    t = phase + np.arange(0.0, seconds, DT)
    law = solve_ivp(
        lambda _, y: (y[1], -GRAVITY / LENGTH * np.sin(y[0])), (0.0, t[-1]), start, t_eval=t, rtol=1e-9, atol=1e-9
    )
    angle, speed = law.y
    return np.asarray(MASS * (GRAVITY * np.cos(angle) + LENGTH * speed**2) * np.cos(angle))


@pytest.mark.parametrize("swing_deg", [5.0, 30.0, 60.0, 90.0])
def test_over_whole_periods_a_pendulum_weighs_what_it_weighs(swing_deg: float) -> None:
    records = [pendulum(swing_deg, PATIENCE, phase) for phase in np.linspace(0.0, 0.6, 13)]
    read = [whole_periods(record).mean() / GRAVITY for record in records]
    assert read == pytest.approx([MASS] * len(read), rel=0.03)
    if swing_deg >= 60:  # 3 - 2 cos of the swing at the lowest point, less what 50 ms smear
        moment = max(record[: round(0.05 / DT)].mean() for record in records) / GRAVITY - MASS
        assert moment > 0.7 * (2 - 2 * np.cos(np.deg2rad(swing_deg))) * MASS


def test_what_does_not_swing_is_averaged_as_it_is() -> None:
    weights = np.full(40, 20.0)
    assert whole_periods(weights) is weights


def holding(
    world: World,
    Ts_tool_bolt: list[Array],
    width: float,
    force: float,
    jaw: str = "jaw_deep",
    R_world_tool: Array | None = None,
) -> Arm:
    """A floating jaw, high over nothing, that has just closed on the first of these eye bolts."""
    arm = floating_arm(world, replace(load_gripper(jaw), force=force))
    T_world_tool = make_transform(DOWN if R_world_tool is None else R_world_tool, (0.0, 0.0, 2.0))
    arm.reset(floating_joints(T_world_tool, arm.gripper.T_flange_tool), width + 0.002)
    for T_tool_bolt in Ts_tool_bolt:
        world.add_part(load_workpiece("ring_screw"), T_world_tool @ T_tool_bolt)
    assert close_jaws(world, arm).parts == (0,)
    return arm


def test_a_swinging_bolt_weighs_like_one(new_world: Callable[..., World]) -> None:
    """Held lightly at the top of its ring and let go from the side; a moment's reading is far off."""
    world, swing = new_world(), turned(60.0, at=(0.0, 0.0, -0.004))
    arm = holding(world, [swing @ make_transform(RING_UP, (0.0, 0.0, WIRE_TOP - 0.004))], width=0.022, force=30.0)
    moments = [weigh(world, arm, 0.05) for _ in range(8)]
    assert max(abs(m.mass - MASS) for m in moments) > 0.3 * MASS
    assert max(m.spread for m in moments) > 0.1 * MASS
    reading = weigh_swinging(world, arm, 0.1 * MASS)
    assert reading.mass == pytest.approx(MASS, rel=0.05)
    assert reading.log.time < PATIENCE + QUIET
    assert close_jaws(world, arm).parts == (0,)


@pytest.mark.parametrize("swing_deg", [0.0, 30.0])
def test_two_bolts_weigh_like_two(new_world: Callable[..., World], swing_deg: float) -> None:
    """One held by its shank, ring down; in its eye hangs the eye of another, at rest or swinging."""
    world = new_world()
    ring_down = make_transform(np.eye(3), (0.0, 0.0, 0.061))
    wire = 0.061 + WIRE_TOP  # of the ring of the first, where the second hangs
    second = turned(swing_deg, at=(0.0, 0.0, wire)) @ make_transform(RING_UP, (0.0, 0.0, wire - 0.023 + WIRE_TOP))
    arm = holding(world, [ring_down, second], width=0.030, force=100.0)
    reading = weigh_swinging(world, arm, 0.1 * MASS)
    assert reading.mass == pytest.approx(2 * MASS, rel=0.05)


def test_grooves_that_press_hard_add_nothing_to_the_weight(new_world: Callable[..., World]) -> None:
    """A bolt held by its shank, level, in V grooves, the tool leaning: its weight turns it against the flanks."""
    world, lean = new_world(), about_axis((0, 1, 0), np.array(np.deg2rad(14.0)))[:3, :3]
    level = make_transform([[1, 0, 0], [0, 0, -1], [0, 1, 0]], (0.0, -0.043, -0.012))
    arm = holding(world, [level], width=0.030, force=240.0, jaw="jaw_v_rod", R_world_tool=DOWN @ lean)
    assert weigh(world, arm, 0.2).mass == pytest.approx(MASS, rel=0.05)


def test_the_sensor_of_cups_is_switched_on_once(new_world: Callable[..., World]) -> None:
    world, switched = new_world(), []
    arm = floating_arm(world, load_gripper("cup_20"))
    switch_on = world.client.enableJointForceTorqueSensor
    world.client.enableJointForceTorqueSensor = lambda *joint: (switched.append(joint), switch_on(*joint))
    assert [weigh(world, arm, 0.01).mass for _ in range(3)] == pytest.approx([0.0] * 3, abs=5e-4)
    assert len(switched) == 1


def turned(angle_deg: float, at: tuple[float, float, float]) -> Array:
    """A turn about the closing direction through a point."""
    turn = about_axis((1, 0, 0), np.array(np.deg2rad(angle_deg)))
    return make_transform(t=at) @ turn @ make_transform(t=-np.array(at))
