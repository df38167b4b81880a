"""What the arm touches on its way in the physics, and how it comes out of a collision with what nobody planned for."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from pickproof.cell.frames import Array, make_transform
from pickproof.cell.geometry.bin import Box
from pickproof.cell.physics.trajectory_execution import execute
from pickproof.grasping.verdict import CHOSEN
from pickproof.robots.kinematics.model import forward
from pickproof.scenarios.campaign.episode import oracle_perception
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.picking.cell_model import SOURCE
from pickproof.scenarios.picking.episode_state import EpisodeState
from pickproof.scenarios.picking.execution import execute_pick
from pickproof.scenarios.picking.grasp_selection import choose
from pickproof.scenarios.picking.pick import attempt_pick
from pickproof.scenarios.picking.plan_selection import decide
from pickproof.scenarios.picking.recovery import recover
from pickproof.scenarios.picking.snapshots import AttemptPictures
from pickproof.scenarios.picking.stages import ComputeTimes, Considered, PlannedPick
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.results.records import Reason

pytestmark = pytest.mark.slow

PLANNED_SEED = 0


@pytest.fixture
def cell() -> Iterator[Workcell]:
    built = Workcell.build(load_scenario("bracket", ["count=3"]), seed=3)
    yield built
    built.close()


def planned(cell: Workcell, state: EpisodeState, attempt: int = 0) -> tuple[Considered, PlannedPick]:
    """What `attempt_pick` will do, as it draws its random numbers."""
    rng = np.random.default_rng((PLANNED_SEED, 1, attempt))
    frame, ids = cell.capture(rng)
    estimates = oracle_perception(cell, frame, ids, rng)
    selection = choose(cell, frame, estimates, state, attempt)
    decision = decide(cell, frame, selection, state, int(rng.integers(2**31)))
    assert decision.pick is not None
    times = ComputeTimes(0.0, 0.0, 0.0)
    return Considered(cell.observe(), frame, estimates, selection, decision, times), decision.pick


def plant(cell: Workcell, q: Array) -> Box:
    """A static box that neither planner nor camera knows, where the gripper's body is at q (6,)."""
    T = forward(cell.robot, q) @ make_transform(t=(0.0, 0.0, 0.045))
    box = Box("planted", (0.05, 0.05, 0.05), make_transform(t=T[:3, 3]))
    cell.world.add_box(box)
    return box


def after_stop(record: object) -> str:
    (node,) = [c for e in record.tree for c in e["candidates"] if c["verdict"] == CHOSEN]  # type: ignore[attr-defined]
    return str(node["after_stop"])


def test_nothing_is_touched_on_planned_ways(cell: Workcell) -> None:
    """The engine's own contact points of arm and gripper body, at every step of two picks; fingers excepted."""
    state = EpisodeState.of(cell)
    for attempt in range(2):
        considered, pick = planned(cell, state, attempt)
        pictures, rng = AttemptPictures(cell, every_stage=False), np.random.default_rng(0)
        executed = execute_pick(cell, state.place, considered, pictures, rng)
        evidence = executed.evidence
        assert evidence.released and not evidence.log.stopped
        assert evidence.log.touched == set() and evidence.log.max_force == 0.0
        state.remember_pick(attempt, executed, cell.arm)
        np.testing.assert_array_equal(state.waits_at, pick.plan.carry.q[-1])


@pytest.mark.parametrize("leg", ["approach", "carry"])
def test_the_arm_draws_back_from_what_it_hits(cell: Workcell, leg: str) -> None:
    state = EpisodeState.of(cell)
    plan = planned(cell, state)[1].plan
    rows = plan.approach.q if leg == "approach" else plan.carry.q
    plant(cell, rows[len(rows) // 2])
    parts = len(cell.observe().parts_in(SOURCE))
    record = attempt_pick(cell, oracle_perception, state, PLANNED_SEED, 0)
    assert (record.moved, record.reason) == (True, Reason.COLLISION)
    assert after_stop(record) == "drew back"
    assert np.abs(cell.arm.q - cell.robot.home).max() < 0.01
    assert len(cell.observe().parts_in(SOURCE)) == parts
    slowly = plan.approach.duration / 2
    assert record.robot_s > slowly


def test_where_the_way_back_is_shut_it_is_said(cell: Workcell) -> None:
    _, pick = planned(cell, EpisodeState.of(cell))
    way_in = pick.plan.approach.q
    cell.arm.hold_jaws(pick.candidate.opening)  # for which it was planned
    assert not execute(cell.world, cell.arm, way_in).stopped
    free = recover(cell, pick.candidate, way_in, way_in[:0], cell.arm.opening)
    assert not free.stopped and np.abs(cell.arm.q - cell.robot.home).max() < 0.01
    assert not execute(cell.world, cell.arm, way_in).stopped
    box = plant(cell, way_in[len(way_in) // 3])
    shut = recover(cell, pick.candidate, way_in, way_in[:0], cell.arm.opening)
    assert shut.stopped and box.name in shut.touched
