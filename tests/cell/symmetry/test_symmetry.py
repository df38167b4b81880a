"""Laws of the symmetry group."""

from __future__ import annotations

import numpy as np
import pytest

from pickproof.cell.symmetry.symmetry import Symmetry

ORDERS = {
    (0.0, 0.0, 0.0): 1,
    (0.0, 0.0, 180.0): 2,
    (180.0, 180.0, 180.0): 4,
    (0.0, 0.0, 60.0): 6,
    (180.0, 0.0, 90.0): 8,
    (90.0, 90.0, 90.0): 24,
}


def contains(group: np.ndarray, R: np.ndarray) -> bool:
    return bool((np.abs(group - R).max(axis=(1, 2)) < 1e-6).any())


@pytest.mark.parametrize(("degrees", "order"), ORDERS.items())
def test_the_finite_rotations_form_a_group(degrees: tuple[float, float, float], order: int) -> None:
    S = Symmetry(degrees).S
    assert len(S) == order
    np.testing.assert_allclose(S[0], np.eye(3))
    for a in S:
        assert contains(S, a.T)
        assert all(contains(S, a @ b) for b in S)


def test_the_trivial_group_weighs_all_axes() -> None:
    assert Symmetry().v.tolist() == [1, 1, 1]
    assert Symmetry().infinite_axis is None and not Symmetry().is_sphere


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_fine_symmetry_counts_as_infinite(axis: int) -> None:
    degrees = [180.0, 180.0, 180.0]
    degrees[axis] = 1.0
    symmetry = Symmetry(tuple(degrees))
    assert symmetry.infinite_axis == axis
    assert symmetry.v.tolist() == np.eye(3)[axis].tolist()
    a = np.eye(3)[axis]
    # the remaining finite part keeps the axis' line
    np.testing.assert_allclose(np.abs(symmetry.S @ a), np.broadcast_to(a, (len(symmetry.S), 3)), atol=1e-9)
    turns = symmetry.rotations(infinite_steps=36)
    assert len(turns) == 36 * len(symmetry.S)
    np.testing.assert_allclose(turns @ a, np.repeat(symmetry.S @ a, 36, axis=0), atol=1e-9)


def test_the_threshold_decides() -> None:
    assert Symmetry((0.0, 0.0, 20.0), infinite_below=20.0).infinite_axis == 2
    assert Symmetry((0.0, 0.0, 20.0), infinite_below=15.0).infinite_axis is None


def test_two_infinite_axes_make_a_sphere() -> None:
    sphere = Symmetry((1.0, 1.0, 0.0))
    assert sphere.is_sphere and sphere.infinite_axis is None
    assert sphere.v.tolist() == [0, 0, 0] and len(sphere.S) == 1


def test_an_infinite_group_is_refused() -> None:
    with pytest.raises(ValueError, match="finite rotation group"):
        Symmetry((50.0, 70.0, 0.0))
