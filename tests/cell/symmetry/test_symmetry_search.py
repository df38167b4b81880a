"""The symmetry that is found is that of the construction, in whatever frame the mesh comes."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.symmetry.symmetry_search import check_degrees, find_symmetry
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.scenarios.config.shipped import WORKPIECES
from tests.cell.workpiece.part_shapes import Shape, shapes

pytestmark = pytest.mark.slow

TOLERANCE = 4e-4
ALL = list(shapes())


def turns(degrees: tuple[float, float, float]) -> np.ndarray:
    return Symmetry(degrees).rotations(24)


@pytest.mark.parametrize("shape", ALL, ids=lambda shape: shape.name)
def test_generated_shapes(shape: Shape) -> None:
    found = find_symmetry(shape.mesh, TOLERANCE)
    # x and y may change places, where the axes of second order are alike, and no more
    allowed = [shape.degrees, (shape.degrees[1], shape.degrees[0], shape.degrees[2])]
    if len(set(shape.degrees)) == 1:
        allowed = [tuple(p) for p in permutations(shape.degrees)]
    assert any(np.allclose(found.degrees, degrees) for degrees in allowed), found.degrees
    assert found.match.residual <= TOLERANCE
    moved = shape.mesh.copy().apply_transform(found.T_part_cad)
    # in the new frame the turns about x, y and z through the origin are symmetries, as the rest of the project takes it
    assert check_degrees(moved, found.degrees, TOLERANCE).residual < 1.5 * TOLERANCE
    assert np.linalg.det(found.T_part_cad[:3, :3]) == pytest.approx(1.0)


def test_there_are_sixty() -> None:
    assert len(ALL) >= 60


@pytest.mark.parametrize("name", sorted(p.parent.name for p in WORKPIECES.glob("*/workpiece.yaml")))
def test_shipped_workpieces(name: str) -> None:
    """As their yaml has it, in the frame of their CAD."""
    workpiece = load_workpiece(name)
    found = find_symmetry(workpiece.mesh, TOLERANCE)
    assert found.degrees == pytest.approx(workpiece.symmetry.degrees)
    np.testing.assert_allclose(found.T_part_cad, np.eye(4), atol=TOLERANCE)
