"""Convex pieces of prismatic solids cover them exactly, and solids of other kinds get none."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pickproof.cell.frames import Array, random_rotations
from pickproof.cell.geometry.nearest import Nearest
from pickproof.cell.workpiece.collision_pieces import CollisionHull
from pickproof.cell.workpiece.decompose import MAX_PRISMS, THINNEST, decompose, piece_mesh
from pickproof.cell.workpiece.prism_pieces import BORE, SLACK, prism_pieces
from tests.cell.workpiece.part_shapes import bent_sheet, extruded, gear, mesh_of, own_parts, pebble, polygon

pytestmark = pytest.mark.slow


def largest_gap(mesh: trimesh.Trimesh, pieces: list[Array]) -> float:
    """How far [m] the solid's surface sticks out of the pieces."""
    hulls = [trimesh.convex.convex_hull(piece) for piece in pieces]
    points = np.concatenate([trimesh.sample.sample_surface(mesh, 2000, seed=1)[0], mesh.vertices])
    return float(np.min([Nearest(h.vertices, h.faces).signed(points) for h in hulls], axis=0).max())


@pytest.mark.parametrize("teeth", [5, 12, 17])
def test_teeth_are_covered_and_nothing_between_them(teeth: int) -> None:
    mesh = mesh_of(gear(teeth, slant=0.2, hub=True))
    pieces = prism_pieces(mesh, MAX_PRISMS)
    assert 0 < len(pieces) <= teeth + 3
    assert largest_gap(mesh, pieces) < 1e-5 + 1e-3 * SLACK[-1]
    bore = 0.3 * (teeth / 2 - 1.25) * 2e-3
    assert 2000 * bore < BORE  # and so it is filled
    solid = Nearest(mesh.vertices, mesh.faces)
    for piece in pieces:
        points = trimesh.sample.sample_surface(trimesh.convex.convex_hull(piece), 400, seed=1)[0]
        outside_the_bore = np.hypot(points[:, 0], points[:, 1]) > bore
        assert solid.signed(points[outside_the_bore]).max() < 1e-3 * 2 * SLACK[-1]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_layers_are_found_along_each_axis(axis: int) -> None:
    """A step of two squares: two boxes, of which the narrow one goes through the wide one."""
    wide, narrow = extruded(polygon(4, 20), 10), extruded(polygon(4, 10), 10).translate((0, 0, 10))
    mesh = mesh_of(wide + narrow)
    mesh = trimesh.Trimesh(np.roll(mesh.vertices, axis + 1, axis=1), mesh.faces)
    pieces = prism_pieces(mesh, MAX_PRISMS)
    assert sorted(round(1e9 * trimesh.convex.convex_hull(p).volume) for p in pieces) == [4000, 8000]


def test_a_wide_hole_stays_open_and_a_narrow_one_is_filled() -> None:
    angle = mesh_of(bent_sheet(width=60, legs=(90, 35)))  # a hole of 10 mm in one leg, a slot of 18 mm in the other
    inside = trimesh.sample.sample_surface(angle, 10, seed=0)[0].mean(axis=0)
    pieces = [trimesh.convex.convex_hull(p) for p in prism_pieces(angle, MAX_PRISMS)]
    hole, slot = np.array([[0.063, 0.021, 0.0015]]), np.array([[0.0015, 0.021, 0.025]])
    held = [max(-float(Nearest(h.vertices, h.faces).signed(p)[0]) for h in pieces) for p in (hole, slot)]
    assert held[0] > 0 > held[1], inside


@pytest.mark.parametrize(
    "body", [pebble(), gear(40), extruded(polygon(5, 30), 40, top=0.4)], ids=["organic", "fine", "taper"]
)
def test_other_solids_have_none(body) -> None:
    assert prism_pieces(mesh_of(body), MAX_PRISMS) == []


def test_a_turned_stack_is_none_of_the_axes() -> None:
    mesh = mesh_of(gear(5))
    mesh.vertices = mesh.vertices @ random_rotations(1, np.random.default_rng(0))[0].T
    assert prism_pieces(mesh, MAX_PRISMS) == []


@pytest.mark.parametrize("name", ["sprocket", "knobble"])
def test_own_parts_stay_within_half_a_millimetre_of_their_pieces(name: str) -> None:
    mesh = mesh_of(own_parts()[name])
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    found = decompose(mesh, False)
    assert found.outside < 6e-4
    for piece in found.pieces:
        hull = piece_mesh(piece)
        if not isinstance(piece, CollisionHull) or np.ptp(hull.vertices @ hull.face_normals.T, axis=0).min() < THINNEST:
            continue  # a box, or a plate that the margins make 2 mm thick
        inner = piece.without_margin()
        assert Nearest(hull.vertices, hull.faces).signed(inner).max() < -0.4e-3
