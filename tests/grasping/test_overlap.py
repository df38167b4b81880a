"""What lies under another workpiece, against areas of blocks known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from pickproof.cell.frames import about_axis, make_transform
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.overlap import EDGE, SPACING, overlaps
from tests.cell.workpiece.solids import block

X, Y, Z = 0.06, 0.05, 0.012
PLATE = block((X, Y, Z), 0.15)


@pytest.mark.parametrize("shift", [0.0, 0.02, 0.045])
@pytest.mark.parametrize("height", [Z, 0.2])
def test_the_area_under_a_plate_is_its_own_less_an_edge(shift: float, height: float) -> None:
    """The upper one reaches past every point that counts by EDGE on all sides; how far above it is does not matter."""
    Ts = np.stack([make_transform(), make_transform(t=(shift, 0.0, height))])
    under = overlaps(PLATE, Ts, np.ones(2, dtype=bool))
    beside = 2 * EDGE if shift == 0.0 else EDGE
    area = (X - shift - beside) * (Y - 2 * EDGE)
    assert under[0] == pytest.approx(area, abs=3 * SPACING * np.sqrt(area))  # points are drawn, one in SPACING^2
    assert under[1] == 0.0
    assert (overlaps(PLATE, Ts, np.array([True, False])) == 0.0).all()  # the upper one is not known to be there


def test_what_touches_side_by_side_does_not_overlap() -> None:
    near = make_transform(
        about_axis((0, 0, 1), np.array(0.1))[:3, :3], (0.0, Y + 0.0045, 0.003)
    )  # by half a millimetre
    assert (overlaps(PLATE, np.stack([make_transform(), near]), np.ones(2, dtype=bool)) == 0.0).all()
    assert overlaps(PLATE, np.zeros((0, 4, 4)), np.zeros(0, dtype=bool)).shape == (0,)


def test_a_rail_with_its_brim_under_that_of_another_overlaps() -> None:
    """Brims hooked by 5 mm over 0.2 m; without the hook, rails beside each other are free."""
    rail = load_workpiece("ps6d_23")
    half = float(rail.mesh.bounds[1, 1])
    low, high = (float(v) for v in rail.mesh.bounds[:, 2])
    over = make_transform(t=(rail.extents[0] - 0.2, 2 * half - 0.005, 0.8 * (high - low)))
    beside = make_transform(t=(0.0, 2 * half + 0.001, 0.01))
    both = np.ones(2, dtype=bool)
    hooked = overlaps(rail, np.stack([make_transform(), over]), both)
    assert 0.5 * 0.2 * 0.005 < hooked[0] < 0.2 * 0.005 and hooked[1] == 0.0
    assert (overlaps(rail, np.stack([make_transform(), beside]), both) == 0.0).all()
