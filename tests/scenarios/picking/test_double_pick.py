"""What the wrist feels after the lift, and what becomes of a pick that is too heavy to be one workpiece."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from io import StringIO
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from pickproof.cell.frames import make_transform
from pickproof.cell.physics.force_torque_sensor import PATIENCE, Reading, weigh
from pickproof.cell.physics.trajectory_execution import MotionLog, close_jaws
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.candidates import GraspCandidate, Selection
from pickproof.grasping.ranking import GraspingConfig
from pickproof.grasping.verdict import CHOSEN
from pickproof.robots.kinematics.inverse import inverse
from pickproof.robots.motion.timing import rest_to_rest
from pickproof.scenarios.campaign.episode import oracle_perception
from pickproof.scenarios.config.scenario import WristConfig, list_scenarios, load_scenario
from pickproof.scenarios.picking import double_pick as weighing
from pickproof.scenarios.picking.cell_model import SOURCE
from pickproof.scenarios.picking.double_pick import count_by_weight, readings
from pickproof.scenarios.picking.episode_state import EpisodeState
from pickproof.scenarios.picking.grasp_selection import choose
from pickproof.scenarios.picking.motion_time import LONGEST, with_motion
from pickproof.scenarios.picking.pick import attempt_pick
from pickproof.scenarios.picking.plan_selection import decide
from pickproof.scenarios.picking.stages import Weighed
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.reporting.explain import explain
from pickproof.scenarios.results.records import AttemptRecord, Reason
from tests.cell.physics.grasp_cell import GraspCell

pytestmark = pytest.mark.slow


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


def attempt_with(heavier: float, *fields: str) -> tuple[Workcell, EpisodeState, AttemptRecord]:
    """One attempt on one bracket that in truth is `heavier` than the CAD says: as if another hung on it."""
    cell = Workcell.build(load_scenario("bracket", ["count=1", *fields]), seed=3)
    state = EpisodeState.of(cell)
    cell.world.client.changeDynamics(cell.world.parts[0], -1, mass=heavier * cell.workpiece.mass)
    return cell, state, attempt_pick(cell, oracle_perception, state, seed=3, attempt=0)


def weighed(record: AttemptRecord) -> str:
    """What the tree says of the weighing."""
    (chosen,) = (c for e in record.tree for c in e["candidates"] if c["verdict"] == CHOSEN)
    return str(chosen["weighed"])


def test_a_pick_that_weighs_like_two_is_put_back_and_left_alone() -> None:
    cell, state, record = attempt_with(2.0)
    try:
        assert record.reason == Reason.DOUBLE_PICK and weighed(record) == "several"
        after = cell.observe()
        assert after.parts_in(SOURCE) == (0,) and after.at_rest.all()
        np.testing.assert_allclose(cell.arm.q, cell.robot.home, atol=1e-3)
        assert state.avoided(after.Ts_world_part, 1, span=4).tolist() == [True]
        assert sum(state.place.used) == 0
    finally:
        cell.close()


def test_a_pick_that_weighs_like_one_is_placed() -> None:
    cell, state, record = attempt_with(1.2)
    try:
        assert record.reason == "" and weighed(record) == "one"
        assert sum(state.place.used) == 1
    finally:
        cell.close()


def test_a_sensor_that_cannot_tell_decides_nothing() -> None:
    cell, state, record = attempt_with(2.0, "wrist.noise_N=1")
    try:
        assert record.reason == "" and weighed(record) == "cannot tell"
        assert sum(state.place.used) == 1
        console = Console(file=StringIO(), width=200)
        explain(record, 0, console)
        assert "workpieces by weight: cannot tell" in console.file.getvalue()  # type: ignore[attr-defined]
    finally:
        cell.close()


@pytest.fixture
def felt(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """A wrist without physics that feels `mass` [kg] steadily, without noise of its own; `lasted` adds up its time."""
    state = {"mass": 0.0, "lasted": 0.0}

    def read(seconds: float) -> Reading:
        state["lasted"] += seconds
        return Reading(state["mass"], 0.0, MotionLog())

    monkeypatch.setattr(weighing, "weigh", lambda world, arm, seconds: read(seconds))
    monkeypatch.setattr(weighing, "weigh_swinging", lambda world, arm, steady, quiet: read(quiet))
    monkeypatch.setattr(weighing, "execute", lambda world, arm, q, stop_above: MotionLog())
    return state


def counts(felt: dict[str, float], mass: float, held: int, rng: np.random.Generator, n: int, **wrist: float) -> Counter:
    """Of `n` weighings of `held` workpieces, what was said; each in time."""
    cell = SimpleNamespace(
        world=None,
        arm=None,
        carrier=SimpleNamespace(raised=lambda cell, carry, height: np.zeros((0, 6))),
        workpiece=SimpleNamespace(mass=mass),
        scenario=SimpleNamespace(wrist=WristConfig(**wrist), limits=SimpleNamespace(contact_force_N=50.0)),
    )
    felt["mass"], felt["lasted"] = held * mass, 0.0
    said = Counter(count_by_weight(cell, None, rng)[0] for _ in range(n))  # type: ignore[arg-type]
    assert felt["lasted"] / n <= 4 * PATIENCE
    return said


@pytest.mark.parametrize("mass", [0.0094, 0.012, 0.02, 0.045, 0.046, 0.048])
def test_where_it_decides_it_is_right(mass: float, felt: dict[str, float]) -> None:
    """Closed form: one for two in 1e-9, two for one in 1.4 % (0.6 * 4.5 sigmas, by any of four readings)."""
    rng, n = np.random.default_rng(1), 4000
    assert counts(felt, mass, 1, rng, n) == {Weighed.ONE: n}
    assert counts(felt, mass, 2, rng, n)[Weighed.SEVERAL] > 0.98 * n


@pytest.mark.parametrize("mass", [0.0001, 0.001, 0.006, 0.0093])
def test_a_part_lighter_than_the_noise_is_never_a_double(mass: float, felt: dict[str, float]) -> None:
    for held in (1, 2):
        assert counts(felt, mass, held, np.random.default_rng(1), 100) == {Weighed.CANNOT_TELL: 100}
    assert felt["lasted"] == 0.0


@pytest.mark.parametrize("double_above", [1.05, 1.2, 1.5, 1.9])
@pytest.mark.parametrize("noise_N", [0.0, 0.01, 0.05, 0.3])
def test_one_is_rarely_taken_for_two_whatever_the_limit(
    noise_N: float, double_above: float, felt: dict[str, float]
) -> None:
    rng, decided = np.random.default_rng(1), 0
    for mass in np.geomspace(0.0005, 5.0, 12):
        said = counts(felt, float(mass), 1, rng, 2000, noise_N=noise_N, double_above=double_above)
        assert said[Weighed.SEVERAL] <= 2
        decided += Weighed.CANNOT_TELL not in said
    assert decided >= 3


@pytest.mark.parametrize("name", list_scenarios())
def test_shipped_parts_are_read_once(name: str) -> None:
    """Heavy enough for the noise: their records are as before light ones were read more often."""
    scenario = load_scenario(name)
    assert readings(scenario.wrist, load_workpiece(scenario.workpiece).mass) == 1


def test_the_nearer_of_equal_grasps_is_wanted() -> None:
    """Candidates that differ in place only are ranked by the arm's way, which is that of its slowest joint."""
    cell = Workcell.build(load_scenario("bracket", ["count=1"]), seed=3)
    try:
        rng = np.random.default_rng(0)
        frame, ids = cell.capture(rng)
        state = EpisodeState.of(cell)
        selection = choose(cell, frame, oracle_perception(cell, frame, ids, rng), state, 0)
        weights = GraspingConfig(
            **{f"weight_{name}": 0.0 for name in selection.candidates[0].terms} | {"weight_motion": 1}
        )
        again = with_motion(selection, cell.robot, cell.robot.home, cell.gripper.T_flange_tool, weights)
        ranks = [c.rank for c in again.candidates]
        assert ranks == sorted(ranks, reverse=True) and 0 < ranks[-1] < ranks[0] < 1
        for c in again.candidates[:: len(ranks) // 5]:
            assert c.terms["motion"] == pytest.approx(1 - _seconds(cell, c) / LONGEST)
        decision = decide(cell, frame, again, state, 0)
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
