"""The grasp oracle: a grasp is tried in a second physics before it is chosen; see docs/explanation/attribution.md.

The second physics holds the bin, the workpieces at their true poses, and a floating gripper. It is built once per
episode and the workpieces are reset before each trial; a trial takes about 0.5 s on one core.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pickproof.cell.frames import Array, make_transform
from pickproof.cell.geometry.bin import Bin, Box
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.physics.floating_gripper import floating_arm, floating_joints, floating_line
from pickproof.cell.physics.grip import grip, held
from pickproof.cell.physics.observation import Snapshot, observe
from pickproof.cell.physics.trajectory_execution import execute
from pickproof.cell.physics.world import World
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.candidates import GraspCandidate
from pickproof.scenarios.config.scenario import Scenario

TRIALS = 10
"""Candidates tried in one attempt; if none holds, the best ranked one is used as without the oracle."""
APPROACH, LIFT = 0.04, 0.12  # [m] of straight line before and after the grasp
ACCELERATION = 12.0  # [m/s2]
AWAY = (0.0, 0.0, -5.0)  # [m] position of workpieces that are not in the bin


class GraspOracle:
    """A second physics of the source bin in which grasps are tried; close it after use.

    Attributes:
        world, arm: of the trial, for recording it.
    """

    def __init__(
        self, scenario: Scenario, workpiece: Workpiece, gripper: Gripper, source: Bin, obstacles: Sequence[Box]
    ) -> None:
        self._workpiece, self._gripper, self._source = workpiece, gripper, source
        self._force_limit = scenario.limits.contact_force_N
        self.world = World(scenario.physics.timestep, scenario.physics.solver_iterations)
        for box in obstacles:
            self.world.add_box(box)
        self.arm = floating_arm(self.world, gripper)

    def close(self) -> None:
        """Close the physics."""
        self.world.close()

    def refuses(self, candidate: GraspCandidate, truth: Snapshot) -> str:
        """Why a grasp does not lift exactly one workpiece from the true poses of all; empty where it does."""
        world, arm, T = self.world, self.arm, candidate.T_world_tool
        start = self._joints(T @ make_transform(t=(0.0, 0.0, -APPROACH)))
        arm.reset(start, candidate.opening)
        inside = self.put_back(truth)
        before = observe(world, [self._source])
        log = execute(world, arm, self._line(start, T), stop_above=self._force_limit)
        if log.stopped:
            return f"touches {log.max_force_against or 'something'}"
        taken = grip(world, arm)
        if len(taken.parts) != 1:
            return "closes on several" if taken.parts else "closes on nothing"
        log = execute(world, arm, self._line(arm.q, make_transform(t=(0.0, 0.0, LIFT)) @ T), self._force_limit)
        lifted = held(world, arm)
        if log.stopped or lifted != taken.parts:
            return "brings up several" if len(lifted) > 1 else "lost in the lift"
        gone = set(observe(world, [self._source]).left(before, self._source.name)) - set(lifted)
        return "throws another out of the bin" if gone & inside else ""

    def put_back(self, truth: Snapshot) -> set[int]:
        """Set every workpiece to its true pose, at rest; returns those in the source bin."""
        world, inside = self.world, set(truth.parts_in(self._source.name))
        for i, T in enumerate(truth.Ts_world_part):
            if i == len(world.parts):
                world.add_part(self._workpiece, T)
            world.place_part(i, T if i in inside else make_transform(t=np.array(AWAY) - (0.0, 0.0, i)))
        world.sleep()
        return inside

    def _line(self, q0: Array, T_world_tool: Array) -> Array:
        q1 = self._joints(T_world_tool)
        q1[3:] = q0[3:]  # straight up or along the tool, without a turn
        return floating_line(q0, q1, ACCELERATION, self.world.dt)

    def _joints(self, T_world_tool: Array) -> Array:
        return floating_joints(T_world_tool, self._gripper.T_flange_tool)
