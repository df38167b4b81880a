"""Grasps tried on a lone workpiece: what holds holds, what cannot hold does not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from pickproof.cell.frames import apply, make_transform, rotation_angle
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.resting_poses import resting_poses
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.candidates import GraspCandidate
from pickproof.grasping.grasp_points import GraspPoint, load_grasps
from pickproof.scenarios.grasp_trials.check import (
    NOVELTY,
    best_candidate,
    check_grasp_points,
    check_table,
    in_order_of_use,
)
from pickproof.scenarios.grasp_trials.trial import FAR, SHIFT, TURN, TrialCell, pose_errors

pytestmark = pytest.mark.slow

BRACKET, JAW = load_workpiece("bracket"), load_gripper("jaw_v1")


@pytest.fixture(scope="module")
def cell() -> Iterator[TrialCell]:
    built = TrialCell(BRACKET, JAW)
    yield built
    built.close()


def grasp(name: str) -> GraspPoint:
    return next(p for p in load_grasps(BRACKET, JAW).points if p.name == name)


def test_a_workpiece_lies_still_in_every_resting_pose(cell: TrialCell) -> None:
    resting = cell.resting_poses()
    assert 3 <= len(resting) <= 8
    for T in resting:
        cell.world.place_part(0, T)
        cell.world.run(0.3)
        moved = cell.world.part_pose(0)
        assert np.linalg.norm(moved[:3, 3] - T[:3, 3]) < 5e-4
        assert rotation_angle(T[:3, :3].T @ moved[:3, :3]) < 0.01


def test_good_grasps_hold_and_bad_ones_do_not(cell: TrialCell) -> None:
    T = cell.resting_poses()[0]
    best = best_candidate(grasp("plate_from_top"), T, BRACKET, JAW)
    assert isinstance(best, GraspCandidate)
    good = cell.try_grasp(T, best.T_world_tool, best.opening)
    assert good.held and good.slip < 1e-3 and good.reason == ""
    high = make_transform(t=(0.0, 0.0, 0.03)) @ best.T_world_tool
    assert cell.try_grasp(T, high, best.opening).reason == "closed on nothing"
    again = cell.try_grasp(T, best.T_world_tool, best.opening)
    assert again.held and again.slip == pytest.approx(good.slip, abs=2e-4)  # trials do not spoil each other


def test_jaws_that_are_off_push_the_workpiece_by_as_much(cell: TrialCell) -> None:
    """Held in the end, but after a push of 4 mm: in a bin that is a neighbour or a wall, and a place missed."""
    tries = ((T, best_candidate(grasp("edge_of_plate"), T, BRACKET, JAW)) for T in cell.resting_poses())
    T, best = next((T, found) for T, found in tries if isinstance(found, GraspCandidate))
    wide = best.opening + 0.010
    for off in (0.0, 0.002, 0.004):
        trial = cell.try_grasp(T, best.T_world_tool @ make_transform(t=(off, 0.0, 0.0)), wide)
        assert trial.held and trial.slip < 1e-3
        assert trial.pushed == pytest.approx(off, abs=7e-4)


def test_without_weight_a_workpiece_stays_in_the_air_until_it_is_gripped(cell: TrialCell) -> None:
    """The same grasp as on the table holds there; where the jaws close on nothing the workpiece falls."""
    T = make_transform(t=(0.0, 0.0, 0.3)) @ cell.resting_poses()[0]
    with cell.world.weightless():
        cell.world.place_part(0, T)
        cell.world.run(0.3)
        np.testing.assert_allclose(cell.world.part_pose(0), T, atol=1e-6)
    cell.world.run(0.1)
    assert T[2, 3] - cell.world.part_pose(0)[2, 3] == pytest.approx(9.81 * 0.1**2 / 2, rel=0.05)
    best = best_candidate(grasp("plate_from_top"), cell.resting_poses()[0], BRACKET, JAW)
    assert isinstance(best, GraspCandidate)
    T_world_tool = make_transform(t=(0.0, 0.0, 0.3)) @ best.T_world_tool
    assert cell.try_grasp(T, T_world_tool, best.opening, weightless=True).held
    assert not cell.try_grasp(T, make_transform(t=(0.0, 0.0, 0.03)) @ T_world_tool, best.opening, weightless=True).held
    cell.world.run(0.2)
    assert cell.world.part_pose(0)[2, 3] < 0.2


def test_grasps_come_in_the_order_in_which_they_add_ways_of_lying() -> None:
    points = list(load_grasps(BRACKET, JAW).points)[:6]
    resting = resting_poses(BRACKET.mesh, BRACKET.symmetry)
    chance = np.array([r.probability for r in resting])
    reached = {
        p.name: np.array([isinstance(best_candidate(p, r.T_plane_part, BRACKET, JAW), GraspCandidate) for r in resting])
        for p in points
    }
    ordered = [p.name for p in in_order_of_use(BRACKET, JAW, points[::-1])]
    assert sorted(ordered) == sorted(reached)
    best = max(reached[name] @ chance for name in ordered)
    assert reached[ordered[0]] @ chance >= best - 2 * NOVELTY
    shared = chance / (1 + reached[ordered[0]])
    assert reached[ordered[1]] @ shared >= max(reached[name] @ shared for name in ordered[1:]) - 2 * NOVELTY


def test_a_workpiece_too_heavy_for_the_force_is_lost() -> None:
    """40 N on each pad at a friction of 0.63 carry 5 kg at rest; 20 kg come out."""
    heavy = replace(BRACKET, mass=20.0, inertia=BRACKET.inertia * 20.0 / BRACKET.mass)
    built = TrialCell(heavy, JAW)
    try:
        T = built.resting_poses()[0]
        best = best_candidate(grasp("plate_from_top"), T, heavy, JAW)
        assert isinstance(best, GraspCandidate)
        assert built.try_grasp(T, best.T_world_tool, best.opening).reason == "lost in the lift"
    finally:
        built.close()


def test_the_table_says_what_holds_where() -> None:
    rows, resting = check_grasp_points(BRACKET, JAW, [grasp("plate_from_top"), grasp("plate_from_below")])
    assert len(rows) == 2 * resting
    verdicts = {
        name: [r["verdict"] for r in rows if r["grasp"] == name] for name in ("plate_from_top", "plate_from_below")
    }
    assert all("holds" in v and "tilt" in v for v in verdicts.values())
    for row in rows:
        assert (row["slip_mm"] is not None) == (row["verdict"] == "holds")
    assert check_table(rows, resting).row_count == 2


def test_pose_errors_are_the_size_that_they_say() -> None:
    errors = pose_errors(load_workpiece("bracket"))
    shifts = np.linalg.norm(errors[:, :3, 3], axis=1)
    turns = rotation_angle(errors[:, :3, :3])
    assert sorted(np.round(shifts, 9)) == [0.0] * 7 + [SHIFT] * 6
    np.testing.assert_allclose(sorted(turns), [0.0] * 7 + [TURN] * 6, atol=1e-9)


def test_turns_move_no_end_of_a_rail_beyond_what_an_image_shows() -> None:
    rail = load_workpiece("ps6d_23")
    errors = pose_errors(rail)
    from_com = rail.mesh.vertices - rail.com
    farthest = [np.linalg.norm(apply(error, from_com) - from_com, axis=1).max() for error in errors]
    np.testing.assert_allclose(max(farthest), FAR, rtol=1e-3)
    assert rotation_angle(errors[:, :3, :3]).max() == pytest.approx(TURN)  # about its length


def test_a_heavy_shaft_hangs_still_in_grooved_fingers() -> None:
    """3.9 kg shaken at 12 m/s2: the floating gripper is heavy enough for the pads to press with what the motor
    gives."""
    shaft, jaw = load_workpiece("gear_shaft"), load_gripper("jaw_v_shaft")
    built = TrialCell(shaft, jaw)
    try:
        T = built.resting_poses()[0]
        hub = next(p for p in load_grasps(shaft, jaw).points if p.name == "hub")
        best = best_candidate(hub, T, shaft, jaw)
        assert isinstance(best, GraspCandidate)
        trial = built.try_grasp(T, best.T_world_tool, best.opening)
    finally:
        built.close()
    assert trial.held and trial.slip < 3e-4 and trial.turn < np.deg2rad(1.0)
