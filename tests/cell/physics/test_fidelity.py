"""The physics against closed forms; docs/measurements/physics.md shows the same experiments as pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pickproof.cell.physics.world import GRAVITY
from tests.cell.physics.laws import down_a_slope, drops, fall, jaw, pad_forces, roller, slip_of_a_grip, stack, tracking
from tests.cell.physics.shaft_cell import carry_shaft
from tests.cell.workpiece.solids import block

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("friction", "force"), [(0.3, 40.0), (0.8, 20.0)])
def test_a_grip_holds_just_below_coulombs_limit_and_slips_just_above(friction: float, force: float) -> None:
    assert slip_of_a_grip(0.97, friction, force) < 1e-4
    assert slip_of_a_grip(1.03, friction, force) > 0.01


@pytest.mark.parametrize("force", [10.0, 80.0])
def test_both_pads_press_with_the_force_of_the_motor(force: float) -> None:
    """At rest the pads are in balance with each other and with the motor."""
    np.testing.assert_allclose(pad_forces(force), force, rtol=0.01)


def test_a_fall_follows_galilei_all_the_way() -> None:
    t, z = fall()
    np.testing.assert_allclose(z, GRAVITY * t * t / 2, atol=2e-4 + 0.01 * z.max())


@pytest.mark.parametrize("angle_deg", [20, 30, 50])
def test_a_block_slides_with_the_acceleration_of_coulomb(angle_deg: float) -> None:
    angle, mu = np.deg2rad(angle_deg), 0.3
    expected = GRAVITY * (np.sin(angle) - mu * np.cos(angle))
    assert down_a_slope(block((0.06, 0.06, 0.02), 0.3), angle, mu) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("angle_deg", [10, 30, 50])
def test_a_cylinder_rolls_and_beyond_3_mu_slides(angle_deg: float) -> None:
    """2/3 g sin as long as friction can turn it, tan <= 3 mu; more than 8 % would be another law (1/2 for a ring)."""
    angle, mu = np.deg2rad(angle_deg), 0.3
    rolling, sliding = 2 / 3 * GRAVITY * np.sin(angle), GRAVITY * (np.sin(angle) - mu * np.cos(angle))
    expected = rolling if np.tan(angle) <= 3 * mu else sliding
    assert down_a_slope(roller(), angle, mu) == pytest.approx(expected, rel=0.08)


@pytest.mark.parametrize("share_of_limits", [0.5, 1.0])
def test_the_servo_follows_within_the_torques(share_of_limits: float) -> None:
    assert tracking(share_of_limits)[1].max() < 1e-5


def test_a_stack_stands_for_ten_seconds() -> None:
    assert stack()[1].max() < 1e-4


def test_nothing_flies_through_a_wall_of_6_mm() -> None:
    """3 m/s is a fall from 0.46 m; a step is then 6 mm long."""
    _, deepest, outside = drops(100, speed=3.0)
    assert outside == 0 and deepest < 0.01


def test_a_groove_carries_the_heavy_shaft_that_flat_fingers_lose() -> None:
    """3.9 kg between hard faces: at 0.15 flat ones carry 2 mu F = 48 N, too little for 3.9 (g + 8 m/s2) = 69 N."""
    hard = jaw("jaw_v_shaft", friction=0.15)
    grooved = carry_shaft(hard, friction=0.15)
    assert grooved.held and grooved.slip < 1e-3 and not grooved.log.touched
    assert not carry_shaft(replace(hard, groove=None), friction=0.15).held


def test_the_shipped_jaw_carries_the_heavy_shaft_with_little_slip() -> None:
    carried = carry_shaft(jaw("jaw_v_shaft"))
    assert carried.held and carried.slip < 5e-4 and carried.turn_deg < 1.0
