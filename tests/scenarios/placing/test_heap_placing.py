from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pickproof.cell.frames import Array, about_axis, apply, invert, make_transform, random_rotations
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.grasping.grasp_points import load_grasps
from pickproof.scenarios.placing.heap_placing import (
    ABOVE,
    DROP,
    MAX_FALL,
    MAX_LEAN,
    SLOTS_AT_ONCE,
    PlacePlan,
    likely_rests,
    place_error,
)
from pickproof.scenarios.placing.slot_grid import YAWS

BIN = Bin("place", (0.26, 0.20, 0.06), 0.006, (0.22, -0.40, 0.01), 0.4)
JAW = load_gripper("jaw_v1")


@pytest.fixture(scope="module")
def bracket() -> Workpiece:
    return load_workpiece("bracket")


@pytest.fixture(scope="module")
def holds(bracket: Workpiece) -> Array:
    """T_part_tool (n, 4, 4): some of the bracket's own grasps, and holds at odd angles."""
    rng = np.random.default_rng(0)
    own = load_grasps(bracket, load_gripper("jaw_v1")).Ts_part_tool
    odd = make_transform(random_rotations(10, rng), rng.uniform(-0.02, 0.02, (10, 3)))
    return np.concatenate([own[rng.choice(len(own), 20, replace=False)], odd])


def parts_in_bin(plan: PlacePlan, T_part_tool: Array) -> Array:
    """T_bin_part of the held part at every proposed pose."""
    return invert(plan.bin.T_world_bin) @ plan.tool_poses(T_part_tool) @ invert(T_part_tool)


def test_a_held_part_is_let_go_as_it_will_lie(bracket: Workpiece, holds: Array) -> None:
    """On a resting face while the tool leans 45 degrees at most, else near it at that lean; then tool down."""
    plan = PlacePlan(BIN, bracket, JAW)
    seen = set()
    for T_part_tool in holds:
        Ts = plan.tool_poses(T_part_tool)
        flat, down = Ts[: -SLOTS_AT_ONCE * YAWS], Ts[-SLOTS_AT_ONCE * YAWS :]
        assert len(flat) in (0, SLOTS_AT_ONCE * YAWS)
        np.testing.assert_allclose(down[:, :3, 2], np.tile([0.0, 0.0, -1.0], (len(down), 1)), atol=1e-12)
        for T in flat:
            assert -T[2, 2] >= np.cos(np.deg2rad(45.0)) - 1e-9
            up = (T @ invert(T_part_tool))[2, :3]  # world z in the CAD frame
            fall = float(np.arccos(np.clip(plan.rests[:, 2, :] @ up, -1.0, 1.0)).min())
            limp = abs(-T[2, 2] - np.cos(MAX_LEAN)) < 1e-9
            assert fall < 1e-6 or (limp and fall <= MAX_FALL + 1e-9)
            seen.add(fall < 1e-6)
    assert seen == {True, False}


def test_the_lowest_point_is_released_just_above_what_lies_below(bracket: Workpiece, holds: Array) -> None:
    plan = PlacePlan(BIN, bracket, JAW)
    layer = float(np.sort(bracket.extents)[1])
    for T_part_tool in holds:
        Ts = parts_in_bin(plan, T_part_tool)
        heights = apply(Ts, bracket.vertices)[..., 2].min(axis=1)
        filled = np.array(plan.used)[plan.slot_of_pose]
        np.testing.assert_allclose(heights, DROP + filled * layer, atol=1e-9)
        plan.fill(0)


def test_the_part_hangs_over_the_middle_of_its_slot_whatever_the_hold(bracket: Workpiece, holds: Array) -> None:
    plan = PlacePlan(BIN, bracket, JAW)
    for T_part_tool in holds:
        centres = parts_in_bin(plan, T_part_tool)[:, :2, 3]
        np.testing.assert_allclose(centres, plan.slots.centres[plan.slot_of_pose], atol=1e-9)
        plan.fill(5)


def test_no_slot_lets_a_part_stick_out_over_a_wall(bracket: Workpiece, holds: Array) -> None:
    plan = PlacePlan(BIN, bracket, JAW)
    flat = holds[0]
    for _ in range(len(plan.slots.centres)):
        Ts = parts_in_bin(plan, flat)
        reach = np.abs(apply(Ts, bracket.vertices)[..., :2]).max(axis=(0, 1))
        assert (reach < np.array(BIN.inner[:2]) / 2).all()
        plan.fill(0)


def test_slots_fill_evenly_in_layers(bracket: Workpiece, holds: Array) -> None:
    plan = PlacePlan(BIN, bracket, JAW)
    n = len(plan.slots.centres)
    assert n >= 4
    rng = np.random.default_rng(1)
    for placed in range(1, 3 * n + 1):
        poses = plan.tool_poses(holds[0])
        plan.fill(int(rng.integers(YAWS)))  # the planner may take any yaw of the first slot
        assert sum(plan.used) == placed
        assert max(plan.used) - min(plan.used) <= 1
        assert len(poses) == len(plan.slot_of_pose)
    assert set(plan.used) == {3}


def test_a_refused_slot_comes_again(bracket: Workpiece, holds: Array) -> None:
    plan = PlacePlan(BIN, bracket, JAW)
    plan.tool_poses(holds[0])
    plan.fill(2 * YAWS)  # the third choice
    assert np.flatnonzero(plan.used).tolist() == [plan.slot_of_pose[2 * YAWS]]
    plan.tool_poses(holds[0])
    assert 2 not in plan.slot_of_pose
    assert plan.slot_of_pose[0] == 0


def test_a_bin_smaller_than_the_part_has_one_slot_in_its_middle(bracket: Workpiece) -> None:
    plan = PlacePlan(replace(BIN, inner=(0.05, 0.04, 0.05)), bracket, JAW)
    np.testing.assert_allclose(plan.slots.centres, [[0.0, 0.0]], atol=1e-12)
    assert plan.tool_poses(np.eye(4)).shape == (2 * YAWS, 4, 4)  # lying flat, and with the tool down


def test_slots_without_a_way_make_room_for_others(bracket: Workpiece, holds: Array) -> None:
    """Every slot comes in turn, however many of them cannot be reached, and heights do not change by it."""
    plan = PlacePlan(replace(BIN, inner=(0.40, 0.30, 0.06)), bracket, JAW)
    assert len(plan.slots.centres) > 2 * SLOTS_AT_ONCE
    seen: set[int] = set()
    for _ in range(plan.rounds):
        heights = apply(parts_in_bin(plan, holds[0]), bracket.vertices)[..., 2].min(axis=1)
        np.testing.assert_allclose(heights, DROP, atol=1e-9)
        seen |= set(plan.slot_of_pose.tolist())
        plan.pass_over()
    assert seen == set(range(len(plan.slots.centres)))
    assert sum(plan.used) == 0


def test_the_error_of_a_placement(bracket: Workpiece) -> None:
    wanted = make_transform(t=(0.2, -0.4, 0.03))
    rests = make_transform(t=(0.203, -0.396, 0.01)) @ about_axis((0, 0, 1), np.array(0.2))
    assert place_error(rests, wanted, bracket) == pytest.approx((0.005, 0.2))
    two_fold = replace(bracket, symmetry=Symmetry((0, 0, 180)))
    turned = rests @ about_axis((0, 0, 1), np.array(np.pi))
    assert place_error(turned, wanted, two_fold) == pytest.approx((0.005, 0.2))


def test_a_round_workpiece_lies_as_well_as_it_stands() -> None:
    """On a plane a candlestick touches foot and drip pan: its axis leans by atan((r_foot - r_pan) / their distance)."""
    candlestick = load_workpiece("candlestick")
    ups = likely_rests(candlestick)[:, 2]
    np.testing.assert_allclose(np.linalg.norm(ups, axis=1), 1.0, atol=1e-9)
    stands, lies = ups[:, 2] > 0.99, np.abs(ups[:, 2]) < 0.5
    assert stands.any() and (stands | lies).all()
    turns = np.sort(np.arctan2(ups[lies, 1], ups[lies, 0]))
    assert np.diff(turns).max() < np.deg2rad(16.0)  # every way round
    rims = np.array([[0.0445, -0.062], [0.033, 0.0455]])  # (radius, height) of the outermost edges
    (r0, z0), (r1, z1) = rims
    np.testing.assert_allclose(ups[lies, 2], -np.sin(np.arctan2(r0 - r1, z1 - z0)), atol=0.02)


def test_held_across_its_stem_a_candlestick_is_laid_down_with_the_tool_nearly_upright() -> None:
    """The lean is that of its axis where it lies, 6 degrees, and of the hold."""
    candlestick = load_workpiece("candlestick")
    plan = PlacePlan(Bin("place", (0.68, 0.36, 0.03), 0.008, (0.22, -0.43, 0.01)), candlestick, JAW, 12)
    straight = make_transform(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), (0.0, 0.0, -0.028))
    Ts = plan.tool_poses(straight)[plan.leaning == 0]
    assert len(Ts) and (-Ts[:, 2, 2] > np.cos(np.deg2rad(10.0))).all()


def test_the_line_down_clears_the_rim_and_what_stands_there(bracket: Workpiece) -> None:
    deep = PlacePlan(replace(BIN, inner=(0.26, 0.20, 0.30)), bracket, JAW)
    assert deep.line == pytest.approx(0.30 + ABOVE)
    flat = PlacePlan(replace(BIN, inner=(0.26, 0.20, 0.001)), bracket, JAW)
    assert 0.014 + ABOVE <= flat.line <= 0.056 + ABOVE + 1e-3
    shallow = replace(BIN, inner=(0.68, 0.36, 0.03))
    assert PlacePlan(shallow, load_workpiece("candlestick"), JAW).line == pytest.approx(0.141 + ABOVE, abs=1e-3)


def test_poses_with_room_for_the_jaws_are_taken_first(bracket: Workpiece, holds: Array) -> None:
    """Whatever their slot and lean; beside a wall some have none."""
    plan = PlacePlan(replace(BIN, inner=(0.26, 0.13, 0.06)), bracket, JAW)
    seen = set()
    for T_part_tool in holds[:10]:
        Ts = plan.tool_poses(T_part_tool)
        order = np.argsort(plan.ranks(), kind="stable")
        room = np.array([plan.room(T, JAW.max_opening) for T in Ts[order]])
        assert (np.diff(room.astype(int)) <= 0).all()
        flat = ~plan.leaning[order]
        assert (np.diff(flat[room].astype(int)) <= 0).all()
        seen |= set(room.tolist())
    assert seen == {True, False}
