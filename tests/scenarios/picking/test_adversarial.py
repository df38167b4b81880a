"""Attempts that only look like a pick, in the real physics: none counts as a success."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from pickproof.cell.frames import Array, invert, make_transform
from pickproof.cell.geometry.bin import Bin, table
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.grip import grip, held, release
from pickproof.cell.physics.observation import Snapshot, observe
from pickproof.cell.physics.trajectory_execution import MotionLog, execute
from pickproof.cell.physics.world import GRAVITY, World
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.robots.kinematics.inverse import inverse
from pickproof.robots.kinematics.model import load_robot
from pickproof.scenarios.picking.cell_model import PLACE, SOURCE
from pickproof.scenarios.picking.outcome import judge
from pickproof.scenarios.picking.stages import Evidence

pytestmark = pytest.mark.slow

SOURCE_BIN = Bin(SOURCE, (0.26, 0.20, 0.06), 0.006, (0.45, 0.0, 0.01))
PLACE_BIN = Bin(PLACE, (0.26, 0.20, 0.06), 0.006, (0.25, -0.36, 0.01))
DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Tool down, jaws closing along world y."""


@dataclass
class Stage:
    """Both bins, brackets flat in the source bin, and the arm with jaws over them."""

    world: World
    arm: Arm

    def see(self) -> Snapshot:
        return observe(self.world, [SOURCE_BIN, PLACE_BIN])

    def to(self, position: Array, steps: int = 300) -> MotionLog:
        """Tool straight to a position [m], not minding what is in between."""
        start = self.arm.tool_pose()[:3, 3]
        s = np.linspace(0, 1, steps + 1)[1:, None]
        s = s**3 * (10 - 15 * s + 6 * s * s)
        Ts = make_transform(DOWN, start + s * (np.asarray(position) - start))
        q = inverse(load_robot("lrmate200id"), Ts @ invert(self.arm.gripper.T_flange_tool), self.arm.q).q[:, 0]
        return execute(self.world, self.arm, q)

    def carry(self) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
        """Take what lies under the tool into the place bin; what was held after closing, lift and carry."""
        x, y, _ = self.arm.tool_pose()[:3, 3]
        self.to((x, y, 0.014))
        closed = grip(self.world, self.arm).parts
        self.to((x, y, 0.16))
        lifted = held(self.world, self.arm)
        self.to((*PLACE_BIN.position[:2], 0.16), 600)
        self.to((*PLACE_BIN.position[:2], 0.03))
        return closed, lifted, held(self.world, self.arm)

    def throw(self, part: int, to: Array, seconds: float = 0.35) -> None:
        """Fling a workpiece so that it flies to a point [m] in a time [s]."""
        at = self.world.part_pose(part)[:3, 3]
        v = (np.asarray(to) - at) / seconds + (0, 0, GRAVITY * seconds / 2)
        self.world.wake(part)
        self.world.client.resetBaseVelocity(self.world.parts[part], v.tolist(), [0, 0, 0])

    def verdict(
        self,
        before: Snapshot,
        holds: tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]] = ((), (), ()),
        released: bool = True,
    ) -> str:
        """What the judge says when everything has come to rest."""
        self.world.run_until_rest(3.0)
        return str(judge(Evidence(before, self.see(), *holds, released, MotionLog(), 5.0, True), 50.0, 30.0))


@pytest.fixture
def stage() -> Iterator[Stage]:
    robot, world, bracket = load_robot("lrmate200id"), World(), load_workpiece("bracket")
    world.add_box(table((1.6, 1.6, 0.04), (0.3, 0.0, 0.0)))
    world.add_bin(SOURCE_BIN)
    world.add_bin(PLACE_BIN)
    for x, y in ((0.45, 0.0), (0.52, 0.06)):
        world.add_part(bracket, make_transform(t=(x, y, 0.0172)))
    arm = Arm(world, robot.urdf, robot.joints, load_gripper("jaw_v1"))
    T = make_transform(DOWN, (0.455, 0.0, 0.16))
    arm.reset(inverse(robot, (T @ invert(arm.gripper.T_flange_tool))[None], robot.home).q[0, 0])
    assert world.run_until_rest(2.0)
    yield Stage(world, arm)
    world.close()


def test_the_same_stage_makes_a_success(stage: Stage) -> None:
    before = stage.see()
    holds = stage.carry()
    assert holds == ((0,), (0,), (0,))
    released = release(stage.world, stage.arm, 0.04).parts == ()
    stage.to((*PLACE_BIN.position[:2], 0.16))
    assert stage.verdict(before, holds, released) == ""


def test_a_part_flung_into_the_place_bin_untouched(stage: Stage) -> None:
    before = stage.see()
    stage.throw(0, (*PLACE_BIN.position[:2], 0.03))
    assert stage.verdict(before) == "ejected"
    assert 0 in stage.see().parts_in(PLACE)


def test_a_part_flung_out_of_the_jaws_into_the_place_bin(stage: Stage) -> None:
    before = stage.see()
    x, y, _ = stage.arm.tool_pose()[:3, 3]
    stage.to((x, y, 0.014))
    closed = grip(stage.world, stage.arm).parts
    stage.to((x, y, 0.16))
    lifted = held(stage.world, stage.arm)
    release(stage.world, stage.arm)
    stage.throw(0, (*PLACE_BIN.position[:2], 0.03))
    stage.world.run(0.4)
    assert stage.verdict(before, (closed, lifted, held(stage.world, stage.arm))) == "dropped"
    assert closed == lifted == (0,) and 0 in stage.see().parts_in(PLACE)


def test_two_parts_carried_between_the_same_jaws(stage: Stage) -> None:
    stage.world.place_part(1, stage.world.part_pose(0) @ make_transform(t=(0.0, 0.0185, 0.0)))
    stage.world.place_part(0, stage.world.part_pose(0) @ make_transform(t=(0.0, 0.0, 0.0)))
    x, y, z = stage.arm.tool_pose()[:3, 3]
    stage.to((x, y + 0.009, z))
    before = stage.see()
    stage.arm.hold_jaws(0.055)
    stage.world.run(0.2)
    holds = stage.carry()
    released = release(stage.world, stage.arm).parts == ()
    stage.to((*PLACE_BIN.position[:2], 0.16))
    assert stage.verdict(before, holds, released) == "double_pick"
    assert stage.see().parts_in(PLACE) == (0, 1)


def test_a_part_pushed_over_the_wall(stage: Stage) -> None:
    """A good pick, but the neighbour goes over the wall of the source bin."""
    before = stage.see()
    holds = stage.carry()
    released = release(stage.world, stage.arm, 0.04).parts == ()
    stage.to((*PLACE_BIN.position[:2], 0.16))
    stage.throw(1, (0.45, 0.22, 0.02))
    assert stage.verdict(before, holds, released) == "ejected"
    assert stage.see().parts_in("") == (1,)


def test_a_part_that_rests_on_the_rim(stage: Stage) -> None:
    """Let go over a corner of the place bin it lies across both walls, its origin between them."""
    before = stage.see()
    holds = stage.carry()
    released = release(stage.world, stage.arm, 0.04).parts == ()
    stage.to((*PLACE_BIN.position[:2], 0.16))
    corner = np.array(PLACE_BIN.inner[:2]) / 2
    rim = PLACE_BIN.inner[2]
    T_bin_part = make_transform(t=(corner[0] - 0.009, corner[1] - 0.009, rim + 0.0075))
    c = np.sqrt(0.5)
    T_bin_part[:3, :3] = [[c, c, 0], [-c, c, 0], [0, 0, 1]]  # across the corner
    stage.world.place_part(0, PLACE_BIN.T_world_bin @ T_bin_part)
    stage.world.wake(0)
    assert stage.verdict(before, holds, released) == "misplaced"
    after = stage.see()
    assert after.on_rim == (0,) and after.parts_in(PLACE) == (0,) and after.at_rest[0]


def test_a_part_that_leaves_the_place_bin_again(stage: Stage) -> None:
    before = stage.see()
    holds = stage.carry()
    released = release(stage.world, stage.arm, 0.04).parts == ()
    stage.to((*PLACE_BIN.position[:2], 0.16))
    stage.world.run(0.3)
    assert stage.see().parts_in(PLACE) == (0,)
    stage.throw(0, (0.25, -0.60, 0.02))
    assert stage.verdict(before, holds, released) == "misplaced"


def test_a_part_held_in_the_place_bin_and_not_released(stage: Stage) -> None:
    before = stage.see()
    holds = stage.carry()
    assert holds[2] == (0,) and stage.see().parts_in(PLACE) == (0,)
    assert stage.verdict(before, holds, released=held(stage.world, stage.arm) == ()) == "misplaced"
    assert stage.see().at_rest[0]
