"""Each kind of gripper empties a bin through the planner and the arm, and fails where physics says that it must."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pickproof.cell.frames import Array, from_rpy, invert, make_transform
from pickproof.cell.geometry.bin import Bin, table
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.magnet import Magnet
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.grip import grip, held, release
from pickproof.cell.physics.observation import observe
from pickproof.cell.physics.trajectory_execution import MotionLog, execute, wait
from pickproof.cell.physics.world import World
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.robots.collision.held_part import HeldPart
from pickproof.robots.collision.scene import CollisionScene
from pickproof.robots.kinematics.model import load_robot
from pickproof.robots.plan.pick_plan import PickPlan, plan_pick
from pickproof.robots.plan.pick_request import CarriedPart, Hand, Lines, MotionLimits, PickRequest, PlacePoses
from pickproof.scenarios.picking.cell_model import PLACE, SOURCE
from pickproof.scenarios.picking.outcome import judge
from pickproof.scenarios.picking.stages import Evidence
from pickproof.scenarios.placing.heap_placing import PlacePlan
from tests.cell.workpiece.solids import block, drilled

pytestmark = pytest.mark.slow

SOURCE_BIN = Bin(SOURCE, (0.26, 0.20, 0.06), 0.006, (0.45, 0.0, 0.01))
PLACE_BIN = Bin(PLACE, (0.30, 0.24, 0.06), 0.006, (0.20, -0.42, 0.01))
OBSTACLES = [table((1.6, 1.6, 0.04), (0.3, 0.0, 0.0)), *SOURCE_BIN.boxes(), *PLACE_BIN.boxes()]
SPOTS = ((0.40, -0.045, 0.3), (0.50, -0.045, -0.4), (0.40, 0.045, 1.2), (0.50, 0.045, 0.0))
BLOCK = block((0.05, 0.032, 0.02), 0.15)
OPENING = 0.038  # [m] of the jaws over the 32 mm


def tool_on(gripper: Gripper, T_world_part: Array, workpiece: Workpiece) -> Array:
    """Tool straight down on the middle of a block that lies flat, jaws across its width."""
    down = 0.012 if gripper.max_opening else 0.001  # tips beside it, or faces pressed on it by 1 mm
    y, z = T_world_part[:3, 1], -T_world_part[:3, 2]
    top = T_world_part[:3, 3] - z * workpiece.extents[2] / 2
    return make_transform(np.stack([y, np.cross(z, y), z], axis=1), top + down * z)


def empty_the_bin(gripper: Gripper, workpiece: Workpiece, count: int) -> list[str]:
    """One attempt on each of `count` workpieces with perfect poses; the judge's verdicts."""
    robot, world = load_robot("lrmate200id"), World()
    for box in OBSTACLES:
        world.add_box(box)
    arm = Arm(world, robot.urdf, robot.joints, gripper)
    arm.reset(robot.home)
    for x, y, yaw in SPOTS[:count]:
        world.add_part(workpiece, from_rpy((x, y, 0.012 + workpiece.extents[2] / 2), (0.0, 0.0, yaw)))
    assert world.run_until_rest(2.0)
    opening = min(OPENING, gripper.max_opening)
    scene = CollisionScene(robot, gripper.flange_boxes(opening), OBSTACLES)
    places, verdicts = PlacePlan(PLACE_BIN, workpiece, gripper), []
    for i in range(count):
        before = observe(world, [SOURCE_BIN, PLACE_BIN])
        T_world_tool = tool_on(gripper, world.part_pose(i), workpiece)
        T_part_tool = invert(world.part_pose(i)) @ T_world_tool
        plan = plan_pick(
            scene,
            PickRequest(
                q_start=robot.home,
                q_end=robot.home,
                T_base_tool_grasp=T_world_tool,
                places=PlacePoses(places.tool_poses(T_part_tool)),
                hand=Hand(gripper.T_flange_tool),
                part=CarriedPart(HeldPart(workpiece.pieces, invert(T_part_tool))),
                lines=Lines(approach=0.06, retract=0.10, place=0.08),
                limits=MotionLimits(carry_acceleration=8.0, dt=world.dt),
            ),
        )
        assert isinstance(plan, PickPlan), plan
        evidence = attempt(world, arm, plan, opening, before)
        verdicts.append(str(judge(evidence, 50.0, 30.0)))
        if evidence.carried:
            places.fill(plan.place)
    world.close()
    return verdicts


def attempt(world: World, arm: Arm, plan: PickPlan, opening: float, before: object) -> Evidence:
    """The moves of a pick; a part that was not taken or lost on the way ends it."""
    arm.hold_jaws(opening)
    start, log = world.time, MotionLog()
    log += execute(world, arm, plan.approach.q)
    taken = grip(world, arm)
    closed, lifted, carried, released = taken.parts, (), (), False
    log += taken.log
    log += execute(world, arm, plan.lift.q)
    lifted = held(world, arm)
    if lifted:
        log += execute(world, arm, plan.carry.q)
        carried = held(world, arm)
        released = release(world, arm, opening + 0.012 if opening else 0.0).parts == ()
        log += wait(world, arm, 0.1)
        log += execute(world, arm, plan.leave.q)
    else:
        release(world, arm, opening)
        arm.reset(load_robot("lrmate200id").home)
    world.run_until_rest(2.0)
    after = observe(world, [SOURCE_BIN, PLACE_BIN])
    return Evidence(before, after, closed, lifted, carried, released, log, world.time - start, True)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["jaw_v1", "cup_20", "magnet_20"])
def test_it_empties_the_bin(name: str) -> None:
    assert empty_the_bin(load_gripper(name), BLOCK, 4) == ["", "", "", ""]


def test_a_cup_does_not_take_perforated_sheet() -> None:
    assert empty_the_bin(load_gripper("cup_20"), drilled((0.06, 0.04, 0.004), 0.05, 0.004, 0.008), 1) == ["missed"]


def test_a_cup_loses_what_is_heavier_than_its_vacuum() -> None:
    """12 N, less what the lift's acceleration takes: a block of 1.3 kg weighs 12.8 N."""
    assert empty_the_bin(load_gripper("cup_20"), block((0.05, 0.032, 0.02), 1.3), 1) == ["slipped"]


def test_a_magnet_loses_what_it_holds_over_a_gap() -> None:
    """60 N / (1 + 2 mm / 0.5 mm)^2 = 2.4 N against 3.9 N; without the cover the same block stays."""
    magnet = load_gripper("magnet_20")
    assert isinstance(magnet, Magnet)
    heavy = block((0.05, 0.032, 0.02), 0.4)
    assert empty_the_bin(replace(magnet, cover=0.002), heavy, 1) == ["slipped"]
    assert empty_the_bin(magnet, heavy, 1) == [""]
    assert empty_the_bin(magnet, replace(heavy, magnetic=False), 1) == ["missed"]


@pytest.mark.parametrize("changes", [{"force": 1.0}, {"friction": 0.001}])
def test_jaws_lose_what_friction_cannot_carry(changes: dict[str, float]) -> None:
    """2 mu F = 1.3 N and, with sqrt(0.5 x 0.001) = 0.022, 1.8 N against 1.5 N of weight and the lift's acceleration."""
    jaw = replace(load_gripper("jaw_v1"), **changes)  # type: ignore[arg-type]
    assert empty_the_bin(jaw, BLOCK, 1)[0] in ("slipped", "missed")
