"""A workpiece that is lost over the place bin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pickproof.scenarios.picking.execution
from pickproof.cell.frames import Array
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.grip import Grip, release
from pickproof.cell.physics.trajectory_execution import MotionLog, execute
from pickproof.cell.physics.world import World
from pickproof.scenarios.campaign.episode import oracle_perception
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.picking.cell_model import PLACE
from pickproof.scenarios.picking.episode_state import EpisodeState
from pickproof.scenarios.picking.pick import attempt_pick
from pickproof.scenarios.picking.workcell import Workcell
from pickproof.scenarios.results.records import Reason

pytestmark = pytest.mark.slow

CARRY = 4
"""Of the motions of a pick: out of the place bin, to the grasp, up, over."""


def test_nothing_goes_where_a_workpiece_was_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jaws that fail just before the place: the next workpieces were put on what lay there, and jammed the arm."""
    motions = 0

    def weak(world: World, arm: Arm, q: Array, stop_above: float | None = None) -> MotionLog:
        nonlocal motions
        motions += 1
        log, late = MotionLog(), int(0.8 * len(q))
        if motions == CARRY:
            log += execute(world, arm, q[:late], stop_above)
            arm.hold_jaws(cell.gripper.max_opening)
            q = q[late:]
        return log + execute(world, arm, q, stop_above)

    monkeypatch.setattr(pickproof.scenarios.picking.execution, "execute", weak)
    cell = Workcell.build(load_scenario("bracket", ["count=2"]), seed=3)
    try:
        state = EpisodeState.of(cell)
        first = attempt_pick(cell, oracle_perception, state, seed=3, attempt=0)
        assert first.reason == Reason.DROPPED
        after = cell.observe()
        assert len(after.parts_in(PLACE)) == 1
        assert sum(state.place.used) == 1 and len(state.placed.surfaces) == 1
        second = attempt_pick(cell, oracle_perception, state, seed=3, attempt=1)
        assert second.success, second.reason
        assert sorted(state.place.used)[-2:] == [1, 1]
        lost, placed = (cell.observe().Ts_world_part[k, :2, 3] for k in cell.observe().parts_in(PLACE))
        assert np.linalg.norm(lost - placed) > cell.workpiece.extents.min()
    finally:
        cell.close()


def test_what_leans_on_both_fingers_is_let_go_by_opening_further(monkeypatch: pytest.MonkeyPatch) -> None:
    """An eye bolt fell across the open fingers, and the attempt counted as misplaced."""
    wanted: list[float | None] = []

    def opens(world: World, arm: Arm, opening: float | None = None) -> Grip:
        wanted.append(opening)
        grip = release(world, arm, opening)
        return replace(grip, parts=(0,)) if len(wanted) == 1 else grip

    monkeypatch.setattr(pickproof.scenarios.picking.execution, "release", opens)
    cell = Workcell.build(load_scenario("bracket", ["count=1"]), seed=3)
    try:
        assert attempt_pick(cell, oracle_perception, EpisodeState.of(cell), seed=3, attempt=0).success
        assert len(wanted) == 2 and wanted[1] == cell.gripper.max_opening
    finally:
        cell.close()
