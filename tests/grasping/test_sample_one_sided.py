"""Proposals for cups and magnets, against the limits of `cell.grippers.one_sided_hold` and the geometry of plain
solids."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pickproof.cell.grippers.one_sided import OneSidedGripper
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.grippers.vacuum import VacuumGripper
from pickproof.cell.physics.contact_probe import probe_part
from pickproof.cell.physics.world import GRAVITY
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.grasp_points import expand
from pickproof.grasping.sample import SPACING, propose
from pickproof.grasping.sample_freeform import freeform_proposals
from pickproof.grasping.sample_one_sided import LIFTED, PRESS, PRESS_ALONE, worst_use
from tests.cell.workpiece.part_shapes import gear, mesh_of
from tests.cell.workpiece.solids import block, drilled, rod

CUP, MAGNET = load_gripper("cup_20"), load_gripper("magnet_20")
PLATE = block((0.06, 0.05, 0.012), 0.15)


@pytest.mark.slow
def test_every_proposal_seals_by_the_rule_of_the_physics_and_carries_the_load() -> None:
    assert isinstance(CUP, OneSidedGripper)
    points = propose(PLATE, CUP, 8, np.random.default_rng(0))
    assert len(points) >= 2
    assert np.linalg.norm(np.asarray(points[0].centre)[:2]) < 0.003  # over the centre of mass
    assert {round(float(p.approach[2])) for p in points} == {-1, 1}  # both wide faces, no narrow one
    for point in points:
        for T in expand((point,), PLATE).Ts_part_tool:
            T = T.copy()
            T[:3, 3] -= PRESS * T[:3, 2]  # where the lip meets the surface
            assert CUP.take(lambda xy, T=T: probe_part(PLATE, T, xy), lambda _: False)[1] == ("",)
            assert worst_use(PLATE, CUP, T) < 1.0
    centres = np.array([p.centre for p in points])
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1) + np.eye(len(points))
    assert apart.min() > SPACING * 0.999 or len(points) == 2


@pytest.mark.slow
def test_the_use_is_that_of_the_cups_limits() -> None:
    """Straight over the centre of mass: pull, and friction against the sideways load; the lever is half the height."""
    assert isinstance(CUP, VacuumGripper)
    (best, *_) = propose(PLATE, CUP, 1, np.random.default_rng(0))
    T = expand((best,), PLATE).Ts_part_tool[0].copy()
    T[:3, 3] = (0.0, 0.0, np.sign(-T[2, 2]) * 0.006)
    pull, side = PLATE.mass * (GRAVITY + LIFTED), PLATE.mass * LIFTED
    bending = side * 0.006 / ((CUP.force - pull) * CUP.radius / 2)
    wanted = max(pull / CUP.force, side / (CUP.friction * (CUP.force - pull)), bending)
    np.testing.assert_allclose(worst_use(PLATE, CUP, T), wanted, rtol=1e-6)


@pytest.mark.slow
def test_nothing_is_proposed_where_no_lip_seals_or_nothing_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pickproof.grasping.sample_one_sided.SPOTS", 300)
    rng = np.random.default_rng
    holed = propose(drilled((0.10, 0.08, 0.01), 0.1, 0.008, 0.2), CUP, 4, rng(0))  # one hole in the middle
    assert holed and min(np.linalg.norm(p.centre[:2]) for p in holed) > 0.010 + 0.004 - 0.002  # it would leak
    ends = propose(rod(0.02, 0.05, 0.1), CUP, 4, rng(0))
    assert ends and all(abs(p.approach[0]) > 0.9 for p in ends)  # its flat ends, and not its round
    assert propose(replace(PLATE, mass=2.0), CUP, 4, rng(0)) == []  # 12 N do not carry it
    assert propose(replace(PLATE, magnetic=False), MAGNET, 4, rng(0)) == []
    assert propose(PLATE, MAGNET, 1, rng(0)) != []


@pytest.mark.slow
def test_a_freeform_workpiece_gets_grasps_of_a_jaw(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bunny has no parallel faces: every proposal has surface at both pads, and none inside the gripper."""
    monkeypatch.setattr("pickproof.grasping.sample_freeform.DIRECTIONS", 60)
    bunny, jaw = load_workpiece("bunny"), load_gripper("jaw_v1")
    points = propose(bunny, jaw, 3, np.random.default_rng(0))
    assert len(points) == 3
    surface = bunny.sample_surface(20_000, seed=8)[0]
    for point in points:
        T = expand((point,), bunny).Ts_part_tool[0]
        p = (surface - T[:3, 3]) @ T[:3, :3]
        for box in jaw.finger_boxes(point.width):
            room = (np.abs(p - box.T_world_box[:3, 3]) - np.asarray(box.size) / 2).max(axis=1)
            assert room.min() > -3e-4
            assert (room < 5e-4).any()


@pytest.mark.slow
def test_teeth_are_gripped_from_straight_above(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gear that lies on a face: jaws across its teeth, one tooth against the gap of two, from either side."""
    monkeypatch.setattr("pickproof.grasping.sample_freeform.DIRECTIONS", 0)
    made = mesh_of(gear(17))
    plain = block((0.038, 0.038, 0.012), 0.08)
    wheel = replace(plain, vertices=made.vertices, faces=made.faces, symmetry=Symmetry((180.0, 0.0, 360 / 17)))
    jaw = load_gripper("jaw_long")
    assert isinstance(jaw, ParallelJaw)
    points = list(freeform_proposals(wheel, jaw, np.random.default_rng(0)))
    down = [p for p in points if abs(p.approach[2]) > 0.999]
    assert down and all(abs(p.closing[2]) < 1e-6 for p in down)
    assert all(0.0365 < p.width < 0.0385 for p in down)  # root circle 29 mm, tip circle 38 mm


@pytest.mark.slow
def test_ten_cups_find_the_one_place_between_the_slots_of_a_rail(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 1,500 places drawn at random none keeps all ten cups off the slots; over the centre of mass there is one."""
    monkeypatch.setattr("pickproof.grasping.sample_one_sided.SPOTS", 100)
    rail, cups = load_workpiece("ps6d_23"), load_gripper("cup_rail")
    assert isinstance(cups, VacuumGripper)
    points = propose(rail, cups, 4, np.random.default_rng(0))
    assert {round(float(p.approach[2])) for p in points} == {-1, 1}  # from above, and within the channel
    assert all(p.depths == (PRESS_ALONE * cups.stroke, PRESS) for p in points)
    assert max(np.linalg.norm(np.asarray(p.centre)[:2]) for p in points) < 1e-6
