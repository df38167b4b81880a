"""A force sensor between flange and gripper: measures the carried mass at rest, without ground truth.

For a jaw, the force is the sum of the contact forces on the gripper, which is in equilibrium at rest. PyBullet's own
joint reaction is not used: with a gripped bolt of 12.4 N it read 40 N along the closing direction, and the contacts
    12.3 N. For cups and magnets it is the joint reaction.
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

QUIET = 0.25  # [s] without swinging after which a reading ends: heavy parts swing with periods of 0.2 to 0.3 s
PATIENCE = 1.2  # [s] longest reading of a workpiece that swings
FILTER = 4  # steps averaged together: contacts alternate from one step to the next


@dataclass(frozen=True)
class Reading:
    """A reading of the sensor while the arm stood still.

    Attributes:
        mass: that the gripper carries in [kg], from the mean force.
        spread: standard deviation of the filtered force in [kg]; large while something swings or rubs.
        log: what was touched meanwhile.
    """

    mass: float
    spread: float
    log: MotionLog


def weigh(world: World, arm: Arm, seconds: float) -> Reading:
    """Carried mass, from the mean vertical force at the wrist while the arm stands still for `seconds`.

    The gripper's own weight is subtracted for any orientation of the tool. A held workpiece that also leans on the heap
    weighs less.
    """
    weights, log = _read(world, arm, seconds)
    return _reading(weights, weights, log)


def weigh_swinging(world: World, arm: Arm, steady: float, quiet: float = QUIET) -> Reading:
    """As `weigh` for a workpiece that may swing: reads until the spread was at most `steady` [kg] for `quiet` [s].

    If it still swings after PATIENCE, the mean over whole periods is used.
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

    Over one period the momentum of a swinging body does not change, so the mean force is its weight at any amplitude;
    the instantaneous force can be three times that. Returns all forces where there is no whole period.
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
    """Weight (n,) in [N] carried by the gripper, after each step."""
    steps, log = max(round(seconds / world.dt), 1), MotionLog()
    forces = np.zeros((steps, 3))
    jaw, body = isinstance(arm.gripper, ParallelJaw), _body(arm)
    # PyBullet prints a line each time it is switched on
    if not (jaw or any(world.client.getJointState(arm.body, body)[2])):
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

    In a query for one body, PyBullet turns the normals towards it, but not friction; in a query for all, neither.
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
