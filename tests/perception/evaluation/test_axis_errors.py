"""Errors of poses by axis: planted ones come out, and symmetric poses are no error."""

from __future__ import annotations

import numpy as np
import pytest

from pickproof.cell.frames import about_axis, from_rpy, invert, make_transform
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.evaluation.analysis import AXES, axis_errors, spread

TRUE = from_rpy((0.1, -0.2, 0.6), (0.4, -0.8, 2.0))


@pytest.mark.parametrize("axis", range(3))
def test_a_planted_error_comes_out_in_its_direction(axis: int) -> None:
    part = load_workpiece("bracket")
    T_com = make_transform(t=part.com)
    for error, at, size in (
        (make_transform(t=0.002 * np.eye(3)[axis]), axis, 2.0),
        (about_axis(np.eye(3)[axis], np.array(np.deg2rad(-3.0))), 3 + axis, -3.0),
    ):
        pred = TRUE @ T_com @ error @ invert(T_com)
        found = axis_errors(pred[None], TRUE[None], np.array([0]), part)
        np.testing.assert_allclose(found[0], size * np.eye(6)[at], atol=1e-6)


def test_symmetric_poses_are_no_error() -> None:
    """Half a turn of a 2-fold part, any turn of a body of revolution; a lean of its axis is one."""
    for name, turn in (("ps6d_23", None), ("candlestick", 0.7)):
        part = load_workpiece(name)
        axis = part.symmetry.infinite_axis
        S = part.symmetry.S[-1] if turn is None else about_axis(np.eye(3)[axis], np.array(turn))[:3, :3]
        found = axis_errors((TRUE @ make_transform(S))[None], TRUE[None], np.array([0]), part)
        np.testing.assert_allclose(found, 0.0, atol=1e-5)
    lean = about_axis(np.eye(3)[(axis + 1) % 3], np.array(np.deg2rad(2.0)))
    found = axis_errors((TRUE @ lean)[None], TRUE[None], np.array([0]), part)
    assert np.linalg.norm(found[0, 3:]) == pytest.approx(2.0)


def test_spread_is_of_right_poses_only() -> None:
    part = load_workpiece("bracket")
    wrong = TRUE @ make_transform(t=(0.05, 0.0, 0.0))
    found = axis_errors(np.stack([TRUE, wrong]), TRUE[None], np.array([0, -1]), part)
    assert len(found) == 1 and spread(found)["x_mm"] == {"median": pytest.approx(0.0), "p95": pytest.approx(0.0)}
    assert spread(np.zeros((0, 6)))[AXES[3]] == {"median": None, "p95": None}
