from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, apply, invert, make_transform
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.symmetry.pose_error import rotation_error
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.grasping.clearance import OpenGripper
from pickproof.grasping.grasp_points import GraspPoses, load_grasps
from pickproof.scenarios.campaign.episode import oracle_perception
from pickproof.scenarios.config.placing import PatternPlace
from pickproof.scenarios.config.scenario import Scenario, load_scenario
from pickproof.scenarios.picking.episode_state import EpisodeState
from pickproof.scenarios.picking.pick import attempt_pick
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.placing.factory import check_room, place_of
from pickproof.scenarios.placing.heap_placing import MAX_LEAN
from pickproof.scenarios.placing.pattern_placing import HOVER, PatternPlan
from pickproof.scenarios.results.records import Reason

pytestmark = pytest.mark.slow

GRID = Path(__file__).with_name("grid.yaml")
JAW = load_gripper("jaw_v1")


@pytest.fixture(scope="module")
def bracket() -> Workpiece:
    return load_workpiece("bracket")


@pytest.fixture(scope="module")
def grasps(bracket: Workpiece) -> GraspPoses:
    return load_grasps(bracket, JAW)


def plan_of(workpiece: Workpiece, *changes: str) -> tuple[PatternPlan, Scenario]:
    scenario = load_scenario(str(GRID), changes)
    plan = place_of(scenario, scenario.place_bin.build("place"), workpiece, JAW)
    assert isinstance(plan, PatternPlan)
    return plan, scenario


def test_cells_stand_at_the_pitch_in_the_turned_fixture() -> None:
    place = PatternPlace(
        kind="pattern", rows=2, columns=3, pitch=(0.1, 0.05), position=(0.01, 0.02, 0.0), yaw_deg=90,
        part_position=(0.0, 0.0, 0.007),
    )  # fmt: skip
    middles = place.Ts_bin_part[:, :3, 3]
    np.testing.assert_allclose(middles.mean(axis=0), (0.01, 0.02, 0.007), atol=1e-12)
    np.testing.assert_allclose(middles[1] - middles[0], (0.0, 0.1, 0.0), atol=1e-12)  # the fixture's x is the bin's y
    np.testing.assert_allclose(middles[3] - middles[0], (-0.05, 0.0, 0.0), atol=1e-12)


def test_every_proposed_pose_lets_the_workpiece_go_as_wanted(bracket: Workpiece, grasps: GraspPoses) -> None:
    """Up to symmetry, a hover over a free cell, the tool leaning little and clear of bin and neighbours."""
    two_fold = replace(bracket, symmetry=Symmetry((0, 0, 180)))
    plan, _ = plan_of(two_fold)
    can = plan.placeable(grasps.Ts_part_tool)
    assert 0 < can.sum() < len(can)
    rng = np.random.default_rng(0)
    seen = 0
    while 0 in plan.used:
        T_part_tool = grasps.Ts_part_tool[rng.choice(np.flatnonzero(can))]
        Ts = plan.tool_poses(T_part_tool, 0.03)
        shape = OpenGripper.of(JAW.boxes(0.03))
        for T, cell in zip(Ts, plan.slot_of_pose, strict=True):
            part = T @ invert(T_part_tool)
            assert plan.used[cell] == 0
            np.testing.assert_allclose(part[:3, 3] - plan.wanted[cell][:3, 3], (0.0, 0.0, HOVER), atol=1e-9)
            assert rotation_error(plan.wanted[cell][:3, :3], part[:3, :3], two_fold.symmetry) < 1e-6
            assert -T[2, 2] >= np.cos(MAX_LEAN) - 1e-12
            placed = [apply(plan.wanted[i], bracket.vertices) for i in np.flatnonzero(plan.used)]
            assert not shape.hits_bin(T[None], plan.bin)[0]
            assert not any(shape.hits_points(T[None], points, -0.001)[0] for points in placed)
        ranks = plan.ranks()
        assert len(ranks) == len(Ts)
        seen += len(Ts)
        if len(Ts) == 0:
            break
        plan.fill(int(np.argmin(ranks)))
    assert seen > 20


def test_a_hold_from_below_has_no_place_upright(bracket: Workpiece, grasps: GraspPoses) -> None:
    """The bracket that is to stand on its plate cannot be put down by fingers that hold it from below."""
    upright = ("place.part_position=[0.0, 0.0, 0.007]", "place.part_rpy_deg=[0, 0, 0]")
    plan, _ = plan_of(bracket, *upright)
    can = plan.placeable(grasps.Ts_part_tool)
    names = np.array([grasps.points[i].name for i in grasps.index])
    assert not can[names == "plate_from_below"].any()
    assert can[names == "plate_from_top"].any()
    left = grasps.placeable(can)
    assert len(left.index) + sum(left.no_place.values()) == len(grasps.index)
    assert left.no_place["plate_from_below"] == (names == "plate_from_below").sum()


@pytest.mark.parametrize(
    ("changes", "names"),
    [
        (["count=7"], ["place.rows: 3", "count = 7", "2 columns make 6"]),
        (["place.pitch=[0.3, 0.06]"], ["place: ", "place_bin.inner"]),
        (["place.part_position=[0, 0, -0.05]"], ["place: ", "over its floor"]),
    ],
)
def test_a_pattern_that_does_not_fit_is_refused(bracket: Workpiece, changes: list[str], names: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        check_room(load_scenario(str(GRID), changes), bracket)
    for name in names:
        assert name in str(caught.value)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ("place.rows=0", "place.pattern.rows"),
        ("place={kind: shelf}", "place"),
        ("place.tolerance_mm=0", "tolerance_mm"),
    ],
)
def test_a_bad_field_of_a_pattern_is_named(change: str, field: str) -> None:
    with pytest.raises(InputError, match=field):
        load_scenario(str(GRID), [change])


def grid_cell(*changes: str) -> Workcell:
    return Workcell.build(load_scenario(str(GRID), ["count=4", *changes]), seed=0)


def test_brackets_are_set_down_on_the_grid_and_others_need_a_regrasp() -> None:
    cell = grid_cell()
    try:
        state = EpisodeState.of(cell)
        records = [attempt_pick(cell, oracle_perception, state, 0, k) for k in range(2)]
        placed = [r for r in records if r.success]
        assert placed
        for r in placed:
            assert r.place_mm is not None and r.place_deg is not None
            assert (r.place_mm, r.place_deg) < (3.0, 5.0)
        assert {r.reason for r in records} <= {"", Reason.NO_PLACE}
        assert any("no_place" in of_point for e in records[0].tree for of_point in e["ruled_out"].values())
        middles: Array = cell.observe().Ts_world_part[list(cell.observe().parts_in("place")), :2, 3]
        wanted = state.place.wanted[:, :2, 3]  # type: ignore[attr-defined]
        assert np.linalg.norm(middles[:, None] - wanted[None], axis=-1).min(axis=1).max() < 0.003
    finally:
        cell.close()


def test_a_workpiece_that_does_not_stay_as_wanted_is_misplaced() -> None:
    """Let go level, flange down, it tips over its flange by 10 degrees: seen, and not a success."""
    cell = grid_cell("place.part_rpy_deg=[180, 0, 0]", "place.part_position=[0, 0, 0.007]")
    try:
        record = attempt_pick(cell, oracle_perception, EpisodeState.of(cell), 0, 0)
    finally:
        cell.close()
    assert (record.moved, record.reason) == (True, Reason.MISPLACED)
    assert record.place_deg == pytest.approx(10.12, abs=0.3)


def test_a_hold_without_a_place_is_a_no_pick() -> None:
    """Only brackets that lie upside down, wanted upright: free grasps there are, but none that can put it down."""
    cell = grid_cell("place.part_rpy_deg=[0, 0, 0]", "place.part_position=[0, 0, 0.007]", "count=1")
    try:
        cell.world.place_part(0, cell.source.T_world_bin @ make_transform(np.diag([1.0, -1.0, -1.0]), (0, 0, 0.012)))
        assert cell.world.run_until_rest(2.0)
        record = attempt_pick(cell, oracle_perception, EpisodeState.of(cell), 0, 0)
    finally:
        cell.close()
    assert (record.moved, record.reason) == (False, Reason.NO_PLACE)
    assert any(c["verdict"] == "no_place" for e in record.tree for c in e["candidates"])
