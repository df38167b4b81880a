"""A bracket on a table, the arm above it, a bin beside: what the tests of grasping share."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pickproof.cell.frames import Array, apply, invert, make_transform, rotation_angle
from pickproof.cell.geometry.bin import Bin, table
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.trajectory_execution import MotionLog, execute
from pickproof.cell.physics.world import World
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.robots.kinematics.inverse import inverse
from pickproof.robots.kinematics.model import RobotModel, load_robot

PLACE = Bin("place", (0.30, 0.22, 0.12), 0.006, (0.25, 0.45, 0.006))
R_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Tool z down, jaws closing along world y: across the width of a bracket that lies along world x."""


@dataclass
class GraspCell:
    """The cell, and the worst slip of the held part since `mark` was called."""

    world: World
    arm: Arm
    robot: RobotModel
    workpiece: Workpiece
    T_tool_part: Array = field(default_factory=lambda: np.eye(4))
    slip: float = 0.0
    slip_deg: float = 0.0

    @staticmethod
    def build(friction: float = 0.5, pad_friction: float = 0.8, force: float = 40.0) -> GraspCell:
        """The bracket at rest on the table, the arm 0.1 m above the grasp."""
        workpiece = replace(load_workpiece("bracket"), friction=friction)
        robot = load_robot("lrmate200id")
        world = World()
        world.add_box(table((1.6, 1.6, 0.04), (0.3, 0.0, 0.0)))
        world.add_bin(PLACE)
        world.add_part(workpiece, make_transform(t=(0.45, 0.0, 0.0072)))
        assert world.run_until_rest(2.0)
        gripper = replace(load_gripper("jaw_v1"), friction=pad_friction, force=force)
        cell = GraspCell(world, Arm(world, robot.urdf, robot.joints, gripper), robot, workpiece)
        cell.arm.reset(cell.solve(cell.above()[None])[0])
        return cell

    def grasp(self) -> Array:
        """T_world_tool at the bracket's centre of mass."""
        com = apply(self.world.part_pose(0), self.workpiece.com[None])[0]
        return make_transform(R_DOWN, (com[0], com[1], 0.004))

    def above(self) -> Array:
        return make_transform(t=(0.0, 0.0, 0.1)) @ self.grasp()

    def solve(self, Ts_world_tool: Array) -> Array:
        """Joint angles (n, 6) of tool poses, in the first front-facing branch."""
        found = inverse(self.robot, Ts_world_tool @ invert(self.arm.gripper.T_flange_tool))
        assert found.valid[:, 0].all()
        return found.q[:, 0]

    def line(self, T_to: Array, acceleration: float) -> MotionLog:
        """Move straight to `T_to` (same orientation) with at most `acceleration` [m/s2] of the tool."""
        T_from = self.arm.tool_pose()
        way = T_to[:3, 3] - T_from[:3, 3]
        # quintic motion profile: its largest acceleration is 10/sqrt(3) d / T^2
        duration = np.sqrt(10 / np.sqrt(3) * np.linalg.norm(way) / acceleration)
        s = np.linspace(0, 1, int(np.ceil(duration / self.world.dt)) + 1)[1:, None]
        s = s**3 * (10 - 15 * s + 6 * s * s)
        q = self.solve(make_transform(T_to[:3, :3], T_from[:3, 3] + s * way))
        log = MotionLog()
        for start in range(0, len(q), 8):
            log += execute(self.world, self.arm, q[start : start + 8])
            self._look()
        return log

    def mark(self) -> None:
        """The part is held as it should stay."""
        self.T_tool_part = invert(self.arm.tool_pose()) @ self.world.part_pose(0)
        self.slip = self.slip_deg = 0.0

    def _look(self) -> None:
        moved = invert(self.T_tool_part) @ invert(self.arm.tool_pose()) @ self.world.part_pose(0)
        com = self.workpiece.com
        self.slip = max(self.slip, float(np.linalg.norm(apply(moved, com[None])[0] - com)))
        self.slip_deg = max(self.slip_deg, float(np.rad2deg(rotation_angle(moved[:3, :3]))))
