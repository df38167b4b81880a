"""Room that a blended motion leaves: round the walls of a bin, and for jaws that are still moving."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pickproof.cell.frames import make_transform
from pickproof.cell.geometry.bin import Box
from pickproof.robots.collision.checker import CLEARANCE_MARGIN
from pickproof.robots.collision.scene import CollisionScene, HeightField
from pickproof.robots.kinematics.inverse import flange_poses
from pickproof.robots.kinematics.model import RobotModel
from pickproof.robots.plan.pick_plan import PickPlan, PickRequest, plan_pick
from tests.robots.arm_cell import CELL, T_FLANGE_TOOL, TOOL, changed, request_at, tilted

pytestmark = pytest.mark.slow

FENCES = [Box("fence", (0.5, 0.006, z), make_transform(t=(0.4, -0.2, z / 2))) for z in np.arange(0.12, 0.2, 0.005)]
WIDER = 0.030  # [m] that each finger stands further out at the start


def planned(scene: CollisionScene, request: PickRequest) -> PickPlan:
    plan = plan_pick(scene, request)
    assert isinstance(plan, PickPlan), plan
    return plan


def swollen(box: Box, by: float) -> Box:
    return replace(box, size=tuple(edge + 2 * by for edge in box.size))


def test_blended_motions_keep_a_clearance_margin_off_walls(robot: RobotModel) -> None:
    """Planned to pass by a hair, a finger landed on the wall: arm and jaws are never quite where they should be."""
    request = changed(request_at(robot, 0.45, 0.0), q_end=None, lines={"straight": 0.02})
    touched: dict[bool, int] = {False: 0, True: 0}
    for fence in FENCES:
        around = CollisionScene(robot, TOOL, [swollen(fence, CLEARANCE_MARGIN / np.sqrt(2))])
        for given in touched:
            plan = planned(CollisionScene(robot, TOOL, [*CELL, fence], kept_clear=("fence",) if given else ()), request)
            around.hold(request.part.held.seen_from(T_FLANGE_TOOL))
            touched[given] += around.path_contact(plan.carry.q) is not None
            around.release()
    assert touched[False] >= 1 and touched[True] == 0


def test_a_blended_motion_may_begin_within_the_clearance_margin(robot: RobotModel) -> None:
    """A part beside a wall can still be taken: the clearance margin is dropped where the line's end is already within
    it."""
    request = changed(request_at(robot, 0.45, 0.0), q_end=None, lines={"straight": 0.02})
    finger = (
        0.0225 + CLEARANCE_MARGIN / 2
    )  # from the tool's middle to a wall that stands higher than the lines are long
    for x in (0.45 - finger - 0.003, 0.45 + finger + 0.003):
        beside = Box("beside", (0.006, 0.1, 0.16), make_transform(t=(x, 0.0, 0.08)))
        free = CollisionScene(robot, [b for b in TOOL if b.name != "palm"], [*CELL, beside])
        kept_clear = CollisionScene(
            robot, [b for b in TOOL if b.name != "palm"], [*CELL, beside], kept_clear=("beside",)
        )
        plans = [plan_pick(scene, request) for scene in (free, kept_clear)]
        assert all(isinstance(plan, PickPlan) for plan in plans), plans


def test_jaws_that_are_still_wide_have_room(robot: RobotModel) -> None:
    """Coming from a wide workpiece the fingers met the wall on the way to a narrow one."""
    first = changed(request_at(robot, 0.45, 0.0), q_end=None, lines={"straight": 0.02})
    waits = planned(CollisionScene(robot, TOOL, CELL), first).carry.q[-1]
    wide = []
    for box in TOOL:
        T = box.T_world_box.copy()
        if box.name.startswith("finger"):
            T[0, 3] += np.copysign(WIDER, T[0, 3])
        wide.append(replace(box, T_world_box=T))
    request = changed(
        request_at(robot, 0.41, 0.03, tilted(20, 60, 30)), q_start=waits, q_end=None, lines={"straight": 0.02}
    )
    request = changed(request, lines={"depart": 0.08})
    met = {0.0: 0, 0.25: 0}
    for fence in FENCES:
        for narrowing in met:
            scene = CollisionScene(robot, TOOL, [*CELL, fence], start_boxes=wide)
            plan = planned(scene, changed(request, hand={"narrowing": narrowing}))
            until = plan.cleared + round(0.25 / plan.approach.dt)
            met[narrowing] += scene.path_contact(plan.approach.q[plan.cleared : until + 1], "leave") is not None
    assert met[0.0] >= 2 and met[0.25] == 0


def test_a_hand_that_stands_among_what_was_placed_gets_out(robot: RobotModel) -> None:
    """Something placed before fell against a finger after the hand let go: no pick began from there any more."""
    first = changed(request_at(robot, 0.45, 0.0), q_end=None, lines={"straight": 0.02})
    waits = planned(CollisionScene(robot, TOOL, CELL), first).carry.q[-1]
    x, y, z = (flange_poses(robot, waits[None])[0] @ first.hand.T_flange_tool)[:3, 3]
    step, half = 0.005, 12
    heights = np.full((2 * half + 1, 2 * half + 1), -0.01)
    heights[half - 8 : half - 3, :] = z + 0.01  # on one side of the tool's middle along y
    heights[:, half + 3 : half + 8] = z + 0.01  # and along x: whichever way the jaws close, a finger is in it
    placed = HeightField(heights, x - half * step, y - half * step, step)
    request = changed(
        request_at(robot, 0.41, 0.03, tilted(20, 60, 30)), q_start=waits, q_end=None, lines={"straight": 0.02}
    )
    request = changed(request, lines={"depart": 0.08})
    scene = CollisionScene(robot, TOOL, CELL, placed=placed, placed_before=placed)
    touched = scene.first_contact(waits, "depart")
    assert touched is not None and touched[1] == "placed"
    planned(scene, request)
