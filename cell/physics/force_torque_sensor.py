"""A force sensor between flange and gripper: what hangs on the arm at rest, without looking at what it is.

Of a jaw it is worked out from the contact forces on the gripper, which at rest is in balance: in one firm grip of a
bolt of 12.4 N PyBullet's own reaction at the joint read 40 N along the closing direction, the contacts 12.3 N. Of cups
and magnets it is that reaction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.arm_urdf import BODY
from pickproof.cell.physics.trajectory_execution import MotionLog, wait
from pickproof.cell.physics.world import GRAVITY, World

QUIET = 0.25  # [s] without swinging, after which a reading is not continued: heavy parts pull once in 0.2 to 0.3 s
PATIENCE = 1.2  # [s] at most for which something that swings is watched
FILTER = 4  # steps that are taken together: contacts alternate from one step to the next


@dataclass(frozen=True)
class Reading:
    """What the wrist felt while the arm stood still.

    Attributes:
        mass: that the gripper carries in [kg], from the mean force.
        spread: standard deviation of the filtered force in [kg]; large while something swings or rubs.
        log: what was touched meanwhile.
    """

    mass: float
    spread: float
    log: MotionLog


def weigh(world: World, arm: Arm, seconds: float) -> Reading:
    """Mass that the gripper carries, from the mean weight at the wrist while the arm stands still for `seconds`.

    Whichever way the tool points, the gripper's own is taken off. Something that is held and also leans on the heap
    weighs less.
    """
    weights, log = _read(world, arm, seconds)
    return _reading(weights, weights, log)


def weigh_swinging(world: World, arm: Arm, steady: float, quiet: float = QUIET) -> Reading:
    """As `weigh`, for something that may swing: until it has hung for `quiet` with a spread of at most `steady` [kg].

    After PATIENCE the mean over whole periods of what still swings is taken.
    """
    weights, log = np.zeros(0), MotionLog()
    while log.time < PATIENCE:
        more, watched = _read(world, arm, quiet)
        weights, log = np.concatenate([weights, more]), log + watched
        if _spread(more) <= steady * GRAVITY:
            return _reading(more, more, log)
    return _reading(whole_periods(weights), weights, log)


def whole_periods(weights: Array) -> Array:
    """The vertical forces (n,) between the first and the last time that they rise through their mean.

    Over a period the momentum of what swings returns to itself, so the mean force on it is its weight, however far it
    swings; for a moment it may be three times that. All forces where there is no whole period.
    """
    over = weights >= weights.mean()
    rises = np.flatnonzero(~over[:-1] & over[1:]) + 1
    return weights[rises[0] : rises[-1]] if len(rises) > 1 else weights


def _reading(counted: Array, watched: Array, log: MotionLog) -> Reading:
    return Reading(float(counted.mean()) / GRAVITY, _spread(watched) / GRAVITY, log)


def _spread(weights: Array) -> float:
    whole = len(weights) // FILTER * FILTER
    return float(weights[:whole].reshape(-1, FILTER).mean(axis=1).std()) if whole else 0.0


def _read(world: World, arm: Arm, seconds: float) -> tuple[Array, MotionLog]:
    """What hangs on the gripper (n,) in [N], after each step."""
    steps, log = max(round(seconds / world.dt), 1), MotionLog()
    forces = np.zeros((steps, 3))
    jaw, body = isinstance(arm.gripper, ParallelJaw), _body(arm)
    if not (jaw or any(world.client.getJointState(arm.body, body)[2])):  # each time it is switched on it prints a line
        world.client.enableJointForceTorqueSensor(arm.body, body, True)
    for step in range(steps):
        log += wait(world, arm, world.dt)
        forces[step] = _contacts(world, arm, body) if jaw else world.client.getJointState(arm.body, body)[2][:3]
    if jaw:
        return -forces[:, 2], log
    mean = forces.mean(axis=0)  # along the vertical, in the axes of the sensor, which stand still
    return forces @ (mean / np.linalg.norm(mean)) - arm.gripper.mass * GRAVITY, log


def _contacts(world: World, arm: Arm, body: int) -> Array:
    """Force (3,) in [N] in world axes, normal and friction, of all that touches the gripper.

    Asked for one body, PyBullet turns normals to point at it, but not friction; asked for all, it turns neither.
    """
    links, total = {body, *arm.finger_links}, np.zeros(3)
    for c in world.client.getContactPoints():
        on_first, on_second = c[1] == arm.body and c[3] in links, c[2] == arm.body and c[4] in links
        if on_first != on_second:
            force = c[9] * np.array(c[7]) + c[10] * np.array(c[11]) + c[12] * np.array(c[13])
            total += force if on_first else -force
    return total


def _body(arm: Arm) -> int:
    """Index of the fixed joint, and of the link, that carries the gripper."""
    return next(index for index, name in arm.link_names.items() if name == BODY)
