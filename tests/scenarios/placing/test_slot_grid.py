from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from pickproof.cell.errors import InputError
from pickproof.cell.frames import about_axis, apply, invert, make_transform
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.scenarios.config.scenario import list_scenarios, load_scenario
from pickproof.scenarios.placing.factory import check_room
from pickproof.scenarios.placing.heap_placing import PlacePlan
from pickproof.scenarios.placing.slot_grid import slots_in

PLACE = Bin("place", (0.96, 0.64, 0.12), 0.016, (0.0, -1.15, 0.01), 0.3)


def test_a_compact_workpiece_keeps_the_choice_of_yaw_where_one_layer_holds_all() -> None:
    bracket = load_workpiece("bracket")
    roomy = Bin("place", (0.40, 0.30, 0.06), 0.006, (0.16, -0.43, 0.01))
    assert slots_in(roomy, bracket, 30).lane is None
    assert len(slots_in(roomy, bracket, 30).centres) == 30
    crowded = slots_in(roomy, bracket, 31)
    assert crowded.lane is not None and len(crowded.centres) > 31


@pytest.mark.parametrize("name", ["gear_shaft", "ps6d_23", "ps6d_24"])
def test_workpieces_in_lanes_lie_inside_and_apart(name: str) -> None:
    """Boxes around the workpieces, as they hang over their slots, neither overlap nor cross a wall."""
    scenario = load_scenario(name)
    workpiece, bin = load_workpiece(scenario.workpiece), scenario.place_bin.build("place")
    plan = PlacePlan(bin, workpiece, load_gripper(scenario.gripper), scenario.count)
    assert plan.slots.lane is not None and len(plan.slots.centres) >= scenario.count
    hold = invert(make_transform(plan.rests[0]) @ about_axis((0, 0, 1), np.array(0.7))) @ about_axis(
        (1, 0, 0), np.array(np.pi)
    )
    rectangles = []
    for _ in range(scenario.count):
        Ts = invert(bin.T_world_bin) @ plan.tool_poses(hold) @ invert(hold)
        points = apply(Ts[0], workpiece.vertices)
        rectangles.append((points.min(axis=0)[:2], points.max(axis=0)[:2]))
        plan.fill(0)
    assert max(plan.used) == 1
    for low, high in rectangles:
        assert (np.abs([low, high]) < np.array(bin.inner[:2]) / 2).all()
    for (low, high), (other_low, other_high) in combinations(rectangles, 2):
        assert ((high < other_low) | (other_high < low)).any()


def test_every_shipped_scenario_has_a_place_for_all() -> None:
    for name in list_scenarios():
        scenario = load_scenario(name)
        check_room(scenario, load_workpiece(scenario.workpiece))


def test_a_place_that_is_too_small_is_refused_in_one_line() -> None:
    scenario = load_scenario("gear_shaft", ["place_bin.inner=[0.5, 0.3, 0.12]", "count=9"])
    with pytest.raises(InputError, match=r"place_bin\.inner: \[0\.5, 0\.3, 0\.12\].*count = 9 x gear_shaft.*2 places"):
        check_room(scenario, load_workpiece("gear_shaft"))
