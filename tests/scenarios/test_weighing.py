"""What the wrist feels after the lift, and what becomes of a pick that is too heavy to be one workpiece."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cell.execute import close_jaws
from cell.frames import make_transform
from cell.wrist import weigh
from grasping.candidates import GraspCandidate, Selection
from grasping.ranking import GraspingConfig
from robots.inverse import inverse
from robots.timing import rest_to_rest
from scenarios.choose import choose
from scenarios.decide import decide
from scenarios.episode import oracle_perception
from scenarios.memory import Memory
from scenarios.motion_rank import LONGEST, with_motion
from scenarios.pick import attempt_pick
from scenarios.records import Reason
from scenarios.scenario import load_scenario
from scenarios.workcell import SOURCE, Workcell
from tests.cell.grasp_cell import GraspCell


@pytest.mark.parametrize("heavier", [1.0, 2.0, 3.0])
def test_the_wrist_feels_the_weight_of_what_is_held(heavier: float) -> None:
    cell = GraspCell.build()
    cell.world.client.changeDynamics(cell.world.parts[0], -1, mass=heavier * cell.workpiece.mass)
    cell.line(cell.grasp(), 5.0)
    assert abs(weigh(cell.world, cell.arm, 0.05).mass) < 5e-4  # [kg], a tenth of the sensor's noise
    assert close_jaws(cell.world, cell.arm).parts == (0,)
    cell.line(cell.above(), 5.0)
    reading = weigh(cell.world, cell.arm, 0.05)
    assert reading.mass == pytest.approx(heavier * cell.workpiece.mass, rel=0.02)
    assert reading.spread < 0.1 * cell.workpiece.mass  # so nothing is read twice
    assert reading.log.time == pytest.approx(0.05, abs=1e-9)


def attempt_with(heavier: float) -> tuple[Workcell, Memory, str]:
    """One attempt on one bracket that in truth is `heavier` than the CAD says: as if another hung on it."""
    cell = Workcell.build(load_scenario("bracket", ["count=1"]), seed=3)
    memory = Memory.of(cell)
    cell.world.client.changeDynamics(cell.world.parts[0], -1, mass=heavier * cell.workpiece.mass)
    record = attempt_pick(cell, oracle_perception, memory, seed=3, attempt=0)
    return cell, memory, str(record.reason)


def test_a_pick_that_weighs_like_two_is_put_back_and_left_alone() -> None:
    cell, memory, reason = attempt_with(2.0)
    try:
        assert reason == Reason.DOUBLE_PICK
        after = cell.observe()
        assert after.parts_in(SOURCE) == (0,) and after.at_rest.all()
        np.testing.assert_allclose(cell.arm.q, cell.robot.home, atol=1e-3)
        assert memory.avoided(after.Ts_world_part, 1, span=4).tolist() == [True]
        assert sum(memory.place.used) == 0
    finally:
        cell.close()


def test_a_pick_that_weighs_like_one_is_placed() -> None:
    cell, memory, reason = attempt_with(1.2)
    try:
        assert reason == ""
        assert sum(memory.place.used) == 1
    finally:
        cell.close()


def test_the_nearer_of_equal_grasps_is_wanted() -> None:
    """Candidates that differ in place only are ranked by the arm's way, which is that of its slowest joint."""
    cell = Workcell.build(load_scenario("bracket", ["count=1"]), seed=3)
    try:
        rng = np.random.default_rng(0)
        frame, ids = cell.capture(rng)
        memory = Memory.of(cell)
        selection = choose(cell, frame, oracle_perception(cell, frame, ids, rng), memory, 0)
        weights = GraspingConfig(
            **{f"weight_{name}": 0.0 for name in selection.candidates[0].terms} | {"weight_motion": 1}
        )
        again = with_motion(selection, cell.robot, cell.robot.home, cell.gripper.T_flange_tool, weights)
        ranks = [c.rank for c in again.candidates]
        assert ranks == sorted(ranks, reverse=True) and 0 < ranks[-1] < ranks[0] < 1
        for c in again.candidates[:: len(ranks) // 5]:
            assert c.terms["motion"] == pytest.approx(1 - _seconds(cell, c) / LONGEST)
        decision = decide(cell, frame, again, memory, 0)
        assert decision.candidate is again.candidates[0] or 0 in decision.refused
        far = replace(
            selection.candidates[0], T_world_tool=make_transform(t=(5.0, 0, 0)) @ selection.candidates[0].T_world_tool
        )
        ranked = with_motion(Selection([far]), cell.robot, cell.robot.home, cell.gripper.T_flange_tool, weights)
        (lost,) = ranked.candidates
        assert lost.rank == 0.0
    finally:
        cell.close()


def _seconds(cell: Workcell, candidate: GraspCandidate) -> float:
    found = inverse(cell.robot, candidate.T_world_tool[None] @ np.linalg.inv(cell.gripper.T_flange_tool))
    seconds = rest_to_rest(cell.robot, found.q[0, [0, 4]] - cell.robot.home)
    return float(seconds[found.valid[0, [0, 4]]].min())
