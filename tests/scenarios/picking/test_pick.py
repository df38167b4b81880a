"""One attempt at a time, with perception handed in, in the real cell."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pickproof.cell.frames import Array, apply, invert, make_transform
from pickproof.grasping.candidates import Selection
from pickproof.scenarios.campaign.episode import oracle_perception
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.picking.cell_model import SOURCE
from pickproof.scenarios.picking.episode_state import AVOID_RADIUS, EpisodeState
from pickproof.scenarios.picking.execution import release_opening
from pickproof.scenarios.picking.grasp_selection import choose
from pickproof.scenarios.picking.heap_heightmap import BIN_MARGIN, GRID, Scan, scene_points
from pickproof.scenarios.picking.pick import Perceive, attempt_pick
from pickproof.scenarios.picking.plan_selection import decide
from pickproof.scenarios.picking.stages import Estimates
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.results.records import Reason

pytestmark = pytest.mark.slow

YAW = 0.6


@pytest.fixture(scope="module")
def cell() -> Iterator[Workcell]:
    """Two brackets in a source bin that is turned in the world."""
    source = f"source_bin={{inner: [0.24, 0.16, 0.06], position: [0.45, 0.02, 0.01], yaw: {YAW}}}"
    built = Workcell.build(load_scenario("bracket", ["count=2", source]), seed=4)
    yield built
    built.close()


@pytest.fixture
def state(cell: Workcell) -> EpisodeState:
    return EpisodeState.of(cell)


def always(Ts_world_part: Array) -> Perceive:
    """Perception that believes in these poses."""
    k = len(Ts_world_part)
    return lambda cell, frame, ids, rng: Estimates(Ts_world_part, np.full(k, 0.9), np.zeros(k))


def empty_corner(cell: Workcell) -> Array:
    """A pose flat on the bin floor, as far from every workpiece as the bin allows; the box in world is turned."""
    x, y = np.meshgrid(np.linspace(-0.06, 0.06, 9), np.linspace(-0.04, 0.04, 9))
    spots = apply(cell.source.T_world_bin, np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.008)], 1))
    true = cell.observe().Ts_world_part[:, :3, 3]
    gaps = np.linalg.norm(spots[:, None] - true[None], axis=2).min(axis=1)
    assert gaps.max() > 0.05
    return cell.source.T_world_bin @ make_transform(t=invert(cell.source.T_world_bin)[:3] @ [*spots[gaps.argmax()], 1])


def test_the_scan_sees_the_workpieces_and_not_the_bin(cell: Workcell) -> None:
    frame, _ = cell.capture(np.random.default_rng(0))
    points = scene_points(cell, frame)
    assert len(points) > 500
    surface = apply(cell.observe().Ts_world_part, cell.workpiece.sample_surface(10_000)[0]).reshape(-1, 3)
    nearest = cKDTree(surface).query(points)[0]
    assert np.quantile(nearest, 0.95) < 0.002
    assert points[:, 2].min() > cell.source.position[2] + BIN_MARGIN


def test_heights_lie_where_the_points_lie_though_the_bin_is_turned(cell: Workcell) -> None:
    frame, _ = cell.capture(np.random.default_rng(0))
    points, field = scene_points(cell, frame), Scan.of(cell, frame).field
    ny, nx = field.heights.shape
    ys, xs = np.mgrid[:ny, :nx]
    nodes = np.stack([field.x0 + GRID * xs, field.y0 + GRID * ys], axis=-1)
    tree = cKDTree(points[:, :2])
    for row, column in [(i, j) for i in range(0, ny, 2) for j in range(0, nx, 2)]:
        under = tree.query_ball_point(nodes[row, column], 0.999 * GRID / 2, p=np.inf)
        if under:
            assert field.heights[row, column] == pytest.approx(points[under, 2].max(), abs=1e-12)
        elif not tree.query_ball_point(nodes[row, column], 1.001 * GRID / 2, p=np.inf):
            assert field.heights[row, column] == pytest.approx(cell.source.position[2] - GRID)
    corners = np.array([[sx * 0.12, sy * 0.08, 0.0] for sx in (-1, 1) for sy in (-1, 1)])
    inner = apply(cell.source.T_world_bin, corners)[:, :2]
    assert (inner > (field.x0 - 1e-9, field.y0 - 1e-9)).all()
    assert (inner < np.array([field.x0 + GRID * nx, field.y0 + GRID * ny])).all()


def test_the_heap_without_a_workpiece_is_lower_where_it_lay_and_nowhere_higher(cell: Workcell) -> None:
    frame, _ = cell.capture(np.random.default_rng(0))
    scan, surface = Scan.of(cell, frame), cell.workpiece.sample_surface(20_000)[0]
    below = 0
    for T in cell.observe().Ts_world_part:
        field, rest = scan.field, scan.without(T, cell.workpiece)
        lower = rest.heights < field.heights
        assert (rest.heights <= field.heights).all() and (rest.heights >= scan.floor).all()
        mine = apply(T, surface)
        column, row = np.rint((mine[:, :2] - (field.x0, field.y0)) / GRID).astype(int).T
        reach = np.zeros_like(lower)
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                reach[np.clip(row + i, 0, len(reach) - 1), np.clip(column + j, 0, reach.shape[1] - 1)] = True
        assert not (lower & ~reach).any()
        below += int(lower.sum())
        on_top = mine[:, 2] > field.heights[row, column] - 0.002  # what the camera saw of it
        if on_top.mean() > 0.3:
            seen = np.unique(np.stack([row, column])[:, on_top], axis=1)
            assert lower[seen[0], seen[1]].mean() > 0.8
    assert below > 20


def test_nothing_found_and_nothing_free_are_told_apart(cell: Workcell, state: EpisodeState) -> None:
    frame, _ = cell.capture(np.random.default_rng(0))
    nothing = decide(cell, frame, Selection([], {}), state, 0)
    blocked = decide(cell, frame, Selection([], {0: {"plate_from_top": {"tilt": 3}}}), state, 0)
    assert (nothing.reason, blocked.reason) == (Reason.NO_DETECTION, Reason.ALL_GRASPS_BLOCKED)
    assert nothing.candidate is nothing.plan is blocked.candidate is blocked.plan is None


def test_seeing_nothing_is_a_no_pick_that_moves_nothing(cell: Workcell, state: EpisodeState) -> None:
    before = cell.observe()
    record = attempt_pick(cell, always(np.zeros((0, 4, 4))), state, seed=0, attempt=0)
    assert (record.moved, record.reason, record.n_estimates) == (False, Reason.NO_DETECTION, 0)
    assert record.robot_s == 0 and record.grasp == "" and record.tree == []
    np.testing.assert_array_equal(cell.observe().Ts_world_part, before.Ts_world_part)


def test_a_pose_where_nothing_lies_is_a_wrong_pose_and_is_left_alone_after(cell: Workcell, state: EpisodeState) -> None:
    wrong = empty_corner(cell)[None]
    first = attempt_pick(cell, always(wrong), state, seed=0, attempt=0)
    assert (first.moved, first.success, first.reason) == (True, False, Reason.WRONG_POSE)
    assert first.error_mm is not None and first.error_mm > 1000 * cell.workpiece.tolerance
    assert first.parts_in_bin_before == 2 == len(cell.observe().parts_in(SOURCE))
    assert state.avoided(wrong, 1, span=4).tolist() == [True]
    assert sum(state.place.used) == 0
    second = attempt_pick(cell, always(wrong), state, seed=0, attempt=1)
    assert (second.moved, second.reason) == (False, Reason.ALL_GRASPS_BLOCKED)
    assert {r for of in second.tree[0]["ruled_out"].values() for r in of} == {"avoided"}


def test_what_is_avoided_is_near_and_recent(state: EpisodeState) -> None:
    state.failed.append((3, np.array([0.4, 0.0, 0.02])))
    Ts = make_transform(t=[[0.4, 0.9 * AVOID_RADIUS, 0.02], [0.4, 1.1 * AVOID_RADIUS, 0.02]])
    assert state.avoided(Ts, attempt=4, span=2).tolist() == [True, False]
    assert state.avoided(Ts, attempt=5, span=2).tolist() == [True, False]
    assert state.avoided(Ts, attempt=6, span=2).tolist() == [False, False]
    state.failed.append((6, Ts[0][:3, 3]))  # once more at the same spot: twice as long
    assert [bool(state.avoided(Ts, attempt=k, span=2)[0]) for k in (7, 10, 11)] == [True, True, False]
    assert state.avoided(Ts[:0], attempt=4, span=2).shape == (0,)


def test_the_plan_ends_the_grasp_where_the_candidate_says(cell: Workcell, state: EpisodeState) -> None:
    rng = np.random.default_rng(0)
    frame, ids = cell.capture(rng)
    selection = choose(cell, frame, oracle_perception(cell, frame, ids, rng), state, 0)
    decision = decide(cell, frame, selection, state, 0)
    assert decision.reason == ""
    assert decision.candidate is not None and decision.plan is not None
    cell.arm.reset(decision.plan.approach.q[-1])
    np.testing.assert_allclose(cell.arm.tool_pose(), decision.candidate.T_world_tool, atol=1e-4)
    cell.arm.reset(cell.robot.home)
    assert set(decision.refused) < set(range(len(selection.candidates)))


def test_a_right_pose_is_picked_from_a_turned_bin(cell: Workcell, state: EpisodeState) -> None:
    record = attempt_pick(cell, oracle_perception, state, seed=0, attempt=0)
    assert record.success, record.reason
    assert len(cell.observe().parts_in(SOURCE)) == 1
    assert sum(state.place.used) == 1 and not state.failed


def test_places_out_of_reach_make_room_for_others_within_one_decision() -> None:
    """The first five slots lie 0.95 m and more from the arm's axis; there is room in the others."""
    far = "place_bin={inner: [0.9, 0.13, 0.06], position: [0.60, -0.43, 0.01], yaw: 3.14159}"
    cell = Workcell.build(load_scenario("bracket", ["count=1", far]), seed=3)
    try:
        state, rng = EpisodeState.of(cell), np.random.default_rng(0)
        frame, ids = cell.capture(rng)
        selection = choose(cell, frame, oracle_perception(cell, frame, ids, rng), state, 0)
        decision = decide(cell, frame, selection, state, 0)
        assert decision.plan is not None and state.place.passed[:5] == [1] * 5
        assert state.place.slot_of_pose[decision.plan.place] >= 5
        assert any(selection.candidates[i] is decision.candidate for i in range(len(selection.candidates)))
        assert all(selection.candidates[i] is not decision.candidate for i in decision.refused)
    finally:
        cell.close()


def test_released_fingers_stay_clear_of_the_place_bins_walls() -> None:
    """Opened all the way, a finger met the wall, and the workpiece stayed in the jaws or was flung out."""
    cell = Workcell.build(load_scenario("bracket", ["count=1"]), seed=3)
    try:
        state = EpisodeState.of(cell)
        beside_wall, in_the_middle = cell.place.position[0] - cell.place.inner[0] / 2 + 0.016, cell.place.position[0]
        for x, least, most in ((beside_wall, 0.014, 0.022), (in_the_middle, 0.038, 0.038)):
            T = make_transform(np.diag([1.0, -1.0, -1.0]), (x, cell.place.position[1], 0.03))
            assert least <= release_opening(cell, state.place, 0.014, T) <= most
        assert attempt_pick(cell, oracle_perception, state, seed=3, attempt=0).success
    finally:
        cell.close()
