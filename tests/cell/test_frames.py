"""Laws of rigid transforms."""

from __future__ import annotations

import numpy as np
import pytest

from pickproof.cell.frames import (
    about_axis,
    apply,
    from_quat_xyzw,
    from_rpy,
    invert,
    make_transform,
    random_rotations,
    rotation_angle,
    to_quat_xyzw,
)


@pytest.fixture
def Ts() -> np.ndarray:
    rng = np.random.default_rng(0)
    return make_transform(random_rotations(20, rng), rng.normal(size=(20, 3)))


def test_a_transform_and_its_inverse_cancel(Ts: np.ndarray) -> None:
    np.testing.assert_allclose(Ts @ invert(Ts), np.broadcast_to(np.eye(4), Ts.shape), atol=1e-12)
    np.testing.assert_allclose(invert(invert(Ts)), Ts, atol=1e-12)


def test_apply_composes_as_the_matrices_do(Ts: np.ndarray) -> None:
    points = np.random.default_rng(1).normal(size=(5, 3))
    np.testing.assert_allclose(apply(Ts[0], apply(Ts[1], points)), apply(Ts[0] @ Ts[1], points), atol=1e-12)
    assert apply(Ts, points).shape == (20, 5, 3)


def test_quaternions_are_ordered_xyzw_and_go_round(Ts: np.ndarray) -> None:
    np.testing.assert_allclose(from_quat_xyzw(Ts[:, :3, 3], to_quat_xyzw(Ts)), Ts, atol=1e-12)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(to_quat_xyzw(from_rpy(rpy=(0, 0, np.pi / 2))), [0, 0, half, half], atol=1e-12)


def test_rpy_turns_about_fixed_axes_as_urdf_does() -> None:
    x, y, z = np.eye(3)
    fixed = about_axis(z, 0.3) @ about_axis(y, 0.2) @ about_axis(x, 0.1)
    np.testing.assert_allclose(from_rpy(rpy=(0.1, 0.2, 0.3)), fixed, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.0, np.pi - 1e-6, np.pi])
def test_the_angle_of_a_turn_is_its_angle(angle: float) -> None:
    assert rotation_angle(about_axis([0, 0.6, 0.8], angle)[:3, :3]) == pytest.approx(angle, abs=1e-9)


def test_random_rotations_are_rotations_without_a_favourite_direction() -> None:
    R = random_rotations(4000, np.random.default_rng(2))
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    assert np.abs(R.mean(axis=0)).max() < 0.03
    # angle density of the uniform distribution: (1 - cos a) / pi, mean pi/2 + 2/pi
    assert rotation_angle(R).mean() == pytest.approx(np.pi / 2 + 2 / np.pi, abs=0.03)
