"""The grasp and the motion oracle in the real physics: they know what they should, and change nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from pickproof.cell.frames import apply, invert, make_transform
from pickproof.cell.physics.floating_gripper import floating_joints, floating_line
from pickproof.grasping.candidates import GraspCandidate
from pickproof.scenarios.campaign.episode import oracle_perception, run_episode
from pickproof.scenarios.campaign.job import Job
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.picking.carriers import ArmCarrier
from pickproof.scenarios.picking.cell_model import SOURCE
from pickproof.scenarios.picking.episode_state import EpisodeState
from pickproof.scenarios.picking.grasp_selection import choose
from pickproof.scenarios.picking.heap_heightmap import scene_points, true_points
from pickproof.scenarios.picking.heap_knowledge import MeasuredHeap
from pickproof.scenarios.picking.pick import attempt_pick
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.results.records import AttemptRecord

pytestmark = pytest.mark.slow

FAR = "source_bin={inner: [0.26, 0.20, 0.06], position: [1.30, 0.0, 0.01]}"
CAMERA = "camera={eye: [1.30, 0.0, 0.86], target: [1.30, 0.0, 0.01]}"
ALL = frozenset({"perception", "grasp", "motion"})


@pytest.fixture(scope="module")
def cell() -> Iterator[Workcell]:
    built = Workcell.build(load_scenario("bracket", ["count=4"]), seed=2, oracle=ALL)
    yield built
    built.close()


def best(cell: Workcell) -> GraspCandidate:
    rng = np.random.default_rng(0)
    frame, ids = cell.capture(rng)
    state = EpisodeState.of(cell)
    return choose(cell, frame, oracle_perception(cell, frame, ids, rng), state, 0).candidates[0]


def test_the_grasp_oracle_tells_what_holds_from_what_does_not_and_leaves_the_cell_alone(cell: Workcell) -> None:
    candidate, before = best(cell), cell.observe()
    high = make_transform(t=(0.0, 0.0, 0.04)) @ candidate.T_world_tool
    deep = make_transform(t=(0.0, 0.0, -0.03)) @ candidate.T_world_tool
    tried = [candidate, *(replace(candidate, T_world_tool=T) for T in (high, deep)), candidate]
    said = [cell.heap.refuses(c) for c in tried]
    assert said[0] == said[3] == ""
    assert said[1] == "closes on nothing"
    assert said[2] != ""
    after = cell.observe()
    np.testing.assert_array_equal(before.Ts_world_part, after.Ts_world_part)
    assert before.time == after.time


def test_true_points_lie_on_every_workpiece_on_all_sides(cell: Workcell) -> None:
    truth = cell.observe()
    points = true_points(cell, truth)
    for i in truth.parts_in(SOURCE):
        local = apply(invert(truth.Ts_world_part[i]), points)
        low, high = cell.workpiece.vertices.min(axis=0), cell.workpiece.vertices.max(axis=0)
        own = local[((local > low - 1e-6) & (local < high + 1e-6)).all(axis=1)]
        assert (own.min(axis=0) < low + 1e-3).all() and (own.max(axis=0) > high - 1e-3).all()
    frame, _ = cell.capture(np.random.default_rng(0))
    assert points[:, 2].min() < scene_points(cell, frame)[:, 2].min()  # the camera sees no underside


def test_a_bin_out_of_the_arms_reach_is_picked_by_the_motion_oracle_alone() -> None:
    def picked(*oracle: str) -> tuple[int, AttemptRecord]:
        records: list[AttemptRecord] = []
        scenario = load_scenario("bracket", [FAR, CAMERA, "count=1"])
        return run_episode(Job(scenario, 0, frozenset(oracle)), records.append).parts_picked, records[0]

    none, first = picked("perception")
    assert (none, first.reason) == (0, "unreachable")
    one, first = picked("perception", "motion")
    assert one == 1 and first.waypoints is None and first.place_mm is not None


def test_oracles_are_used_where_named_only() -> None:
    cell = Workcell.build(load_scenario("bracket", ["count=1"]), seed=0)
    try:
        assert isinstance(cell.heap, MeasuredHeap) and isinstance(cell.carrier, ArmCarrier)
        np.testing.assert_array_equal(cell.home, cell.robot.home)
        state = EpisodeState.of(cell)
        assert attempt_pick(cell, oracle_perception, state, 0, 0).waypoints
    finally:
        cell.close()


@pytest.mark.parametrize("seed", range(5))
def test_the_floating_gripper_goes_where_it_is_told_and_keeps_the_acceleration(cell: Workcell, seed: int) -> None:
    rng = np.random.default_rng(seed)
    lean = floating_joints(make_transform(np.diag([1.0, -1.0, -1.0]), (0.4, 0.1, 0.3)), np.eye(4))
    lean += np.array([0, 0, 0, *rng.uniform(-0.7, 0.7, 3)])
    cell.arm.reset(lean)
    T = cell.arm.tool_pose()
    q = floating_joints(T, cell.gripper.T_flange_tool, near=lean + np.array([0, 0, 0, 6.2, 0, 0]))
    cell.arm.reset(q)
    np.testing.assert_allclose(cell.arm.tool_pose(), T, atol=1e-6)
    assert abs(q[3] - lean[3] - 6.2) <= np.pi
    way = floating_line(lean, q, 5.0, 1 / 480)
    np.testing.assert_allclose(way[-1], q, atol=1e-12)
    full = np.vstack([lean, way])
    assert np.linalg.norm(np.diff(full, 2, axis=0)[:, :3], axis=1).max() * 480**2 < 5.0 * 1.02
    cell.arm.reset(cell.home)
