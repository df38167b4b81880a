"""A force sensor between flange and gripper: what hangs on the arm at rest, without looking at what it is."""

from __future__ import annotations

import numpy as np

from cell.arm import Arm
from cell.execute import MotionLog, wait
from cell.urdf import BODY
from cell.world import GRAVITY, World


def weigh(world: World, arm: Arm, seconds: float) -> tuple[float, MotionLog]:
    """Mass [kg] that the gripper carries, from the mean force at the wrist while the arm stands still for `seconds`.

    The force on the joint between flange and gripper is the weight of both, whichever way the tool points; the
    gripper's own is taken off. Something that is held and also leans on the heap weighs less.
    """
    client, joint = world.client, _joint(world, arm)
    client.enableJointForceTorqueSensor(arm.body, joint, True)
    log, force = MotionLog(), np.zeros(3)
    steps = max(round(seconds / world.dt), 1)
    for _ in range(steps):
        log += wait(world, arm, world.dt)
        force += client.getJointState(arm.body, joint)[2][:3]
    return float(np.linalg.norm(force / steps)) / GRAVITY - arm.gripper.mass, log


def _joint(world: World, arm: Arm) -> int:
    """Index of the fixed joint that carries the gripper."""
    return next(index for index, name in arm.link_names.items() if name == BODY)
