"""Collision pieces of any solid are near it both ways, and the physics takes them, thin plates too."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import manifold3d as m3
import numpy as np
import pytest
import trimesh

from pickproof.cell.frames import make_transform
from pickproof.cell.geometry.bin import table
from pickproof.cell.physics.world import World
from pickproof.cell.workpiece.collision_pieces import HULL_MARGIN, CollisionHull
from pickproof.cell.workpiece.convex_cuts import convex_cuts
from pickproof.cell.workpiece.decompose import decompose
from pickproof.cell.workpiece.piece_errors import error_bound, piece_errors
from tests.cell.workpiece.solids import solid

pytestmark = pytest.mark.slow

Bar = tuple[tuple[float, float, float], tuple[float, float, float]]


def of_bars(*bars: Bar) -> trimesh.Trimesh:
    """Boxes of sizes at centres, in [mm], made one solid in [m]."""
    whole = m3.Manifold()
    for size, at in bars:
        whole += m3.Manifold.cube(size, True).translate(at)
    return in_metres(whole)


def in_metres(body: m3.Manifold) -> trimesh.Trimesh:
    made = body.to_mesh64()
    return trimesh.Trimesh(1e-3 * np.array(made.vert_properties[:, :3]), np.array(made.tri_verts), process=False)


def z_bracket(t: float) -> trimesh.Trimesh:
    """Of plates `t` [mm] thick."""
    return of_bars(((25, 30, t), (-(25 - t) / 2, 0, 15 - t / 2)), ((t, 30, 30), (0, 0, 0)),
                   ((25, 30, t), ((25 - t) / 2, 0, t / 2 - 15)))  # fmt: skip


def elbow() -> trimesh.Trimesh:
    """Two round bars across each other in one corner, and a bore of 8 mm through one of them."""
    bar = m3.Manifold.cylinder(40, 10, 10, 48)
    whole = bar + bar.rotate((90, 0, 0)) + m3.Manifold.sphere(10, 48)
    return in_metres(whole - m3.Manifold.cylinder(60, 4, 4, 32).translate((0, 0, -10)))


@pytest.mark.parametrize("t", [1.2, 1.5, 2.0, 2.5, 4.0])
def test_a_bracket_of_plates_falls_and_lies(t: float) -> None:
    """Plates of exactly two margins shrink to nothing: the hull of their moved corners was flat, a QhullError."""
    mesh = z_bracket(t)
    found = decompose(mesh, False)
    hulls = tuple(piece for piece in found.pieces if isinstance(piece, CollisionHull))
    part = replace(solid(mesh, 0.03, 0.4, found.pieces), collision_hulls=hulls)
    with closing(World()) as world:
        world.add_box(table((1.0, 1.0, 0.1), (0.0, 0.0, 0.0)))
        world.add_part(part, make_transform(t=(0.0, 0.0, 0.03)))
        assert world.run_until_rest(3.0)
        low = (world.part_pose(0) @ np.column_stack([mesh.vertices, np.ones(len(mesh.vertices))]).T)[2].min()
    assert abs(low) < 2e-4
    assert found.within


@pytest.mark.parametrize("thickness", [1.0, 1.3, 2.0, 2.1])
def test_a_thin_hull_becomes_two_margins_thick_and_no_wider(thickness: float) -> None:
    box = trimesh.creation.box((0.03, 0.02, 1e-3 * thickness))
    layer = CollisionHull(np.array(box.vertices)).without_margin()
    assert np.ptp(layer, axis=0)[:2] == pytest.approx([0.028, 0.018], abs=1e-4)
    assert np.ptp(layer, axis=0)[2] + 2 * HULL_MARGIN == pytest.approx(max(0.0021, 1e-3 * thickness), abs=1e-4)


@pytest.mark.parametrize("size", [(0.03, 0.02, 0.0009), (0.03, 0.0015, 0.0015)])
def test_what_is_thinner_is_refused(size: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="a hull is thinner than"):
        CollisionHull(np.array(trimesh.creation.box(size).vertices)).without_margin()


SHAPES = {
    "elbow with a bore": elbow,
    "channel": lambda: of_bars(((60, 40, 6), (0, 0, 0)), ((6, 40, 30), (-27, 0, 15)), ((6, 40, 30), (27, 0, 15))),
    "cross": lambda: of_bars(((60, 12, 12), (0, 0, 0)), ((12, 60, 12), (0, 0, 0)), ((12, 12, 60), (0, 0, 0))),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_pieces_are_near_the_solid_both_ways(shape: str) -> None:
    mesh = SHAPES[shape]()
    found = decompose(mesh, False)
    assert found.bound == max(5e-4, 0.02 * mesh.extents.max())
    # a bore that bends leaves corners of its hulls a little over the bound, which the pieces say of themselves
    slack = 1.2 if "elbow" in shape else 1.0
    assert max(found.outside, found.felt) <= slack * found.bound
    assert found.within == (max(found.outside, found.felt) <= found.bound)
    assert piece_errors(mesh, found.pieces) == (found.outside, found.beyond, found.felt)


def test_cuts_along_the_faces_are_exact() -> None:
    """Three bars across each other are five or seven boxes, whatever the bound."""
    mesh = SHAPES["cross"]()
    parts = convex_cuts(mesh, 1e-4, 20)
    assert 3 < len(parts) <= 7
    volume = sum(trimesh.convex.convex_hull(part).volume for part in parts)
    assert volume == pytest.approx(mesh.volume, rel=1e-6)


def test_a_narrow_hole_is_closed_and_a_wide_one_is_not() -> None:
    plate = m3.Manifold.cube((60, 60, 8), True)
    for diameter, share in ((3.0, 0.001), (16.0, 0.03)):
        mesh = in_metres(plate - m3.Manifold.cylinder(20, diameter / 2, diameter / 2, 48, True))
        found = decompose(mesh, False)
        assert found.within and found.bound == error_bound(0.06)
        filled = sum(trimesh.convex.convex_hull(part).volume for part in convex_cuts(mesh, found.bound, 32))
        assert (filled - mesh.volume) / mesh.volume < share + 0.01 and found.beyond <= max(1.2e-3, 1e-3 * diameter / 2)
