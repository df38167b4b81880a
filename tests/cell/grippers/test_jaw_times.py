"""Times of the jaws by their formula are those of the physics."""

from __future__ import annotations

import pytest

from pickproof.cell.physics.trajectory_execution import close_jaws, jaw_times, open_jaws
from tests.cell.physics.grasp_cell import GraspCell

WIDTH, OPENING, RELEASED = 0.018, 0.030, 0.046


def test_jaw_times_are_those_of_the_physics() -> None:
    cell = GraspCell.build()
    try:
        cell.line(cell.grasp(), 15.0)
        open_jaws(cell.world, cell.arm, OPENING)
        closing, opening = jaw_times(cell.arm.jaw, OPENING, WIDTH, RELEASED)
        jaws = close_jaws(cell.world, cell.arm)
        assert jaws.parts == (0,)
        assert jaws.log.time == pytest.approx(closing, abs=0.03)
        assert open_jaws(cell.world, cell.arm, RELEASED).log.time == pytest.approx(opening, abs=0.03)
    finally:
        cell.world.close()
