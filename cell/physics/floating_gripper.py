"""A gripper without an arm: three prismatic joints, then yaw, pitch and roll; only the gripper can collide.

It replaces the arm where arm motion is not under test: in grasp trials, the grasp oracle and the motion oracle.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pickproof.cell.frames import Array, invert, make_transform
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.world import World

URDF = Path(__file__).resolve().parent / "floating_gripper.urdf"
HOME = 0.6  # [m] height of the TCP over the place bin before the first pick
JOINTS = ("x", "y", "z", "yaw", "pitch", "roll")
TURNING = 40.0  # [rad/s2] of yaw, pitch and roll


def floating_arm(world: World, gripper: Gripper) -> Arm:
    """The floating gripper, its prismatic joints at the world's origin."""
    return Arm(world, URDF, JOINTS, gripper)


def floating_joints(T_world_tool: Array, T_flange_tool: Array, near: Array | None = None) -> Array:
    """Joints (6,) in [m] and [rad] that bring the TCP to T_world_tool (4, 4).

    Roll lies in [0, 2 pi), so that it does not jump while the tool points down; yaw within half a turn of that of
    `near` (6,), else of 0.
    """
    T_world_flange = T_world_tool @ invert(T_flange_tool)
    yaw, pitch, roll = Rotation.from_matrix(T_world_flange[:3, :3]).as_euler("ZYX")
    if near is not None:
        yaw += 2 * np.pi * np.rint((near[3] - yaw) / (2 * np.pi))
    return np.array([*T_world_flange[:3, 3], yaw, pitch, roll % (2 * np.pi)])


def floating_home(place: Bin, gripper: Gripper) -> Array:
    """Joints (6,) before the first pick: over the place bin, the tool down."""
    x, y, _ = place.position
    return floating_joints(make_transform(np.diag([1.0, -1.0, -1.0]), (x, y, HOME)), gripper.T_flange_tool)


def floating_line(q0: Array, q1: Array, acceleration: float, dt: float) -> Array:
    """Straight from rest at q0 to rest at q1 (6,) with a quintic motion profile; (n, 6), the start left out.

    Args:
        acceleration: largest linear acceleration of the flange in [m/s2]; TURNING limits the rotations.
    """
    far = max(np.linalg.norm(q1[:3] - q0[:3]) / acceleration, float(np.abs(q1[3:] - q0[3:]).max()) / TURNING)
    duration = np.sqrt(10 / np.sqrt(3) * far)
    s = np.linspace(0, 1, max(int(np.ceil(duration / dt)), 2) + 1)[1:, None]
    return np.asarray(q0 + s**3 * (10 - 15 * s + 6 * s * s) * (q1 - q0))


def floating_flange(q: Array) -> Array:
    """T_world_flange (n, 4, 4) at joints q (n, 6), the inverse of `floating_joints`."""
    return make_transform(Rotation.from_euler("ZYX", q[:, 3:]).as_matrix(), q[:, :3])
