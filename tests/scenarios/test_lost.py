"""A workpiece that is lost over the place bin."""

from __future__ import annotations

import numpy as np
import pytest

import scenarios.move
from cell.arm import Arm
from cell.execute import MotionLog, execute
from cell.frames import Array
from cell.world import World
from scenarios.episode import oracle_perception
from scenarios.memory import Memory
from scenarios.pick import attempt_pick
from scenarios.records import Reason
from scenarios.scenario import load_scenario
from scenarios.workcell import PLACE, Workcell

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

    monkeypatch.setattr(scenarios.move, "execute", weak)
    cell = Workcell.build(load_scenario("bracket", ["count=2"]), seed=3)
    try:
        memory = Memory.of(cell)
        first = attempt_pick(cell, oracle_perception, memory, seed=3, attempt=0)
        assert first.reason == Reason.DROPPED
        after = cell.observe()
        assert len(after.parts_in(PLACE)) == 1
        assert sum(memory.place.used) == 1 and len(memory.placed.surfaces) == 1
        second = attempt_pick(cell, oracle_perception, memory, seed=3, attempt=1)
        assert second.success, second.reason
        assert sorted(memory.place.used)[-2:] == [1, 1]
        lost, placed = (cell.observe().Ts_world_part[k, :2, 3] for k in cell.observe().parts_in(PLACE))
        assert np.linalg.norm(lost - placed) > cell.workpiece.extents.min()
    finally:
        cell.close()
