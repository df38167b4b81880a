"""Trials of grasps in the physics on a single workpiece: no arm, no bin, no neighbours.

A floating gripper moves to a workpiece in a resting pose on a table, grips, lifts and shakes it with the acceleration
of a transfer. The grasp holds if the workpiece is then still between the fingers.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import product

import numpy as np

from pickproof.cell.frames import Array, about_axis, apply, invert, make_transform, rotation_angle
from pickproof.cell.geometry.bin import Bin, table
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.physics.convergence import solver_iterations
from pickproof.cell.physics.floating_gripper import floating_arm, floating_joints, floating_line
from pickproof.cell.physics.grip import Grip, grip, held
from pickproof.cell.physics.trajectory_execution import execute
from pickproof.cell.physics.world import World
from pickproof.cell.workpiece.workpiece import Workpiece

FREE = Bin("table", (20.0, 20.0, 1e-4), 0.01, (0.0, 0.0, 0.0))
"""A bin without effect: only a large floor."""
LIKELY = 0.02  # probability of a resting pose below which it is not looked at
POSES = 8
BEFORE = 0.03  # [m] of straight line before the grasp
LIFT, SHAKE = 0.10, 0.06  # [m]
ACCELERATION = 12.0  # [m/s2] of lift and shake: what a scenario allows to the held workpiece
SHIFT, TURN = 0.0015, np.deg2rad(2.0)  # errors of a pose for which a grasp is tried, along and about each axis
FAR = 0.010  # [m] limit of the motion of any point by a rotation error: depth images show the ends of a rail


@dataclass(frozen=True)
class Trial:
    """Result of one trial: whether the workpiece was still held, and its slip in the fingers.

    Attributes:
        slip, turn: of its centre of mass in [m] and of itself in [rad], from grip to the end of the shake.
        pushed: largest displacement [m] of a corner of its bounding box until it was gripped.
    """

    held: bool
    slip: float
    turn: float
    reason: str
    pushed: float = 0.0


@dataclass(frozen=True)
class PlacedGrasp:
    """A grasp on a workpiece at a given pose.

    Attributes:
        T_world_part, T_world_tool: (4, 4) of the workpiece, and of the TCP at the grasp.
        opening: of the jaws during the approach, in [m].
        weightless: gravity acts only after the grip, so the workpiece may be anywhere in the air.
    """

    T_world_part: Array
    T_world_tool: Array
    opening: float
    weightless: bool = False


class TrialCell:
    """A table, one workpiece and a floating gripper; use it for many trials, then close it."""

    def __init__(self, workpiece: Workpiece, gripper: Gripper, iterations: int | None = None) -> None:
        """Build it.

        Args:
            iterations: of the contact solver; by default those of a scenario with this workpiece and gripper.
        """
        self.workpiece, self.gripper = workpiece, gripper
        self.world = World(solver_iterations=iterations or solver_iterations(workpiece, gripper))
        self._build()

    def _build(self) -> None:
        self.world.add_box(table((8.0, 8.0, 0.1), (0.0, 0.0, 0.0)))
        self.arm = floating_arm(self.world, self.gripper)
        self.arm.reset(np.array([0.0, 0.0, 3.0, 0.0, np.pi, 0.0]))
        self.world.add_part(self.workpiece, make_transform(t=(0.0, 0.0, 1.0)))

    def rebuild(self) -> None:
        """Reset the world, so that a trial does not depend on those before, not even in the last bit."""
        self.world.restart()
        self._build()

    def close(self) -> None:
        """Close the physics."""
        self.world.close()

    def resting_poses(self) -> Array:
        """Ts_world_part (k, 4, 4) in which the workpiece lies still on the table, likeliest first."""
        Ts, _ = self.workpiece.mesh.compute_stable_poses(sigma=0.0, n_samples=1, threshold=LIKELY)
        found: list[Array] = []
        for T in np.asarray(Ts).reshape(-1, 4, 4)[:POSES]:
            self.world.place_part(0, make_transform(t=(-T[0, 3], -T[1, 3], 0.001)) @ T)
            rested = self.world.run_until_rest(3.0, sleep=False)
            pose = self.world.part_pose(0)
            if rested and not any(np.abs(pose[2, :3] - p[2, :3]).max() < 0.02 for p in found):
                found.append(pose)
        return np.asarray(found).reshape(-1, 4, 4)

    def try_grasp(self, T_world_part: Array, T_world_tool: Array, opening: float, weightless: bool = False) -> Trial:
        """Grip the workpiece that lies at T_world_part with the TCP at T_world_tool, lift and shake it.

        Args:
            opening: of the jaws during the approach, in [m].
            weightless: gravity acts only after the grip, so the workpiece may be anywhere in the air.
        """
        taken = self._grip(T_world_part, T_world_tool, opening, weightless)
        if taken.parts != (0,):
            return Trial(False, 0.0, 0.0, ", ".join(sorted({f for f in taken.faces if f})) or "closed on nothing")
        T_world_gripped = self.world.part_pose(0)
        T_tool_gripped = invert(self.arm.tool_pose()) @ T_world_gripped
        lost = self._lost_in_motion(T_world_tool)
        if lost:
            return Trial(False, 0.0, 0.0, lost)
        slip, turn = self._slip(invert(T_tool_gripped) @ invert(self.arm.tool_pose()) @ self.world.part_pose(0))
        return Trial(True, slip, turn, "", self._farthest_move(T_world_part, T_world_gripped))

    def _grip(self, T_world_part: Array, T_world_tool: Array, opening: float, weightless: bool) -> Grip:
        """To the grasp on a straight line, and close."""
        before = self._joints(T_world_tool @ make_transform(t=(0.0, 0.0, -BEFORE)))
        self.arm.reset(before, opening if isinstance(self.gripper, ParallelJaw) else None)
        with self.world.weightless() if weightless else nullcontext():
            self.world.place_part(0, T_world_part)
            self._line(T_world_tool)
            return grip(self.world, self.arm)

    def _lost_in_motion(self, T_world_tool: Array) -> str:
        """Lift and shake the held workpiece; returns where it was lost, empty if it is still held."""
        for way in ((0.0, 0.0, LIFT), (SHAKE, 0.0, LIFT), (0.0, SHAKE, LIFT)):
            self._line(make_transform(t=way) @ T_world_tool)
            if held(self.world, self.arm) != (0,):
                return "lost in the lift" if way[:2] == (0.0, 0.0) else "lost in the shake"
        return ""

    def _slip(self, T_gripped_now: Array) -> tuple[float, float]:
        """Slide of the centre of mass in [m] and turn in [rad] of a workpiece that moved so in the gripper."""
        com = np.append(self.workpiece.com, 1.0)
        slid = float(np.linalg.norm((T_gripped_now @ com - com)[:3]))
        return slid, float(rotation_angle(T_gripped_now[:3, :3]))

    def _farthest_move(self, T_world_before: Array, T_world_after: Array) -> float:
        """Way in [m] of the corner of the workpiece's bounding box that moved farthest between two poses."""
        corners = self.workpiece.mesh.bounding_box.vertices
        shift = apply(T_world_after, corners) - apply(T_world_before, corners)
        return float(np.linalg.norm(shift, axis=1).max())

    def _line(self, T_world_tool: Array) -> None:
        """Straight to a tool pose of the same rotation, from rest to rest."""
        q0, q1 = self.arm.q, self._joints(T_world_tool)
        q1[3:] = q0[3:]
        execute(self.world, self.arm, floating_line(q0, q1, ACCELERATION, self.world.dt))

    def _joints(self, T_world_tool: Array) -> Array:
        return floating_joints(T_world_tool, self.gripper.T_flange_tool)


def turn_errors(workpiece: Workpiece) -> Array:
    """Errors (3,) [rad] about the axes of the CAD through the centre of mass: TURN, or what moves a point by FAR."""
    from_com = np.asarray(workpiece.mesh.vertices) - workpiece.com
    levers = [np.linalg.norm(np.delete(from_com, axis, axis=1), axis=1).max() for axis in range(3)]
    return np.minimum(TURN, FAR / np.array(levers))


def pose_errors(workpiece: Workpiece) -> Array:
    """Errors T_part_estimate (13, 4, 4): none, then SHIFT along and `turn_errors` about each axis both ways."""
    errors = [np.eye(4)]
    for (axis, turn), sign in product(zip(np.eye(3), turn_errors(workpiece), strict=True), (1, -1)):
        errors += [make_transform(t=sign * SHIFT * axis), about_axis(axis, np.array(sign * turn))]
    return np.stack(errors)


def try_errors(cell: TrialCell, grasp: PlacedGrasp, errors: Array) -> Iterator[Trial]:
    """Trials of a grasp with each of the pose errors `errors` (n, 4, 4), in their order.

    An error is T_part_estimate about the centre of mass: a shift along and a turn about the axes of the CAD there.
    """
    for error in errors:
        T_world_tool = moved_by_error(error, grasp.T_world_part, cell.workpiece) @ grasp.T_world_tool
        yield cell.try_grasp(grasp.T_world_part, T_world_tool, grasp.opening, grasp.weightless)


def moved_by_error(error: Array, T_world_part: Array, workpiece: Workpiece) -> Array:
    """T_world_world (4, 4) by which an error of the pose, T_part_estimate about the centre of mass, moves a tool."""
    T_world_com = T_world_part @ make_transform(t=workpiece.com)
    return np.asarray(T_world_com @ error @ invert(T_world_com))


def robust_share(cell: TrialCell, grasp: PlacedGrasp) -> float:
    """Share of pose errors, about the centre of mass, under which a grasp still holds."""
    return float(np.mean([trial.held for trial in try_errors(cell, grasp, pose_errors(cell.workpiece))]))
