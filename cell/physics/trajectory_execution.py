"""Execution of joint trajectories in the physics, with a log of all contacts of the arm.

Contacts are read after every step of 2 ms, so every impact is recorded.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pickproof.cell.errors import SimulationError
from pickproof.cell.frames import Array
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.world import World

HELD_FORCE = 0.5  # [N] force of each finger from which a workpiece counts as held
STILL = 2e-3  # [m/s] finger speed under which the jaws have stopped
CLOSE_SETTLE = 0.05  # [s] the fingers must have stood still on a workpiece before it is lifted
OPEN_SETTLE = 0.02  # [s] the fingers must have stood still before the gripper leaves
CLOSE_EASE, OPEN_EASE = 0.04, 0.02  # [s] measured extra time of closing and opening over motion at full speed
DOZE_EVERY = 48  # steps between checks for workpieces that have come to rest and can sleep
MAX_ERROR = 0.02  # [rad] following error at which a controller stops


@dataclass
class MotionLog:
    """Log of a motion: contacts, tracking error and time.

    Attributes:
        time: simulated in [s].
        max_error: largest tracking error of any joint in [rad].
        max_force: largest normal force [N] of one body on the arm and the gripper's body, fingers excepted.
        max_force_link, max_force_against: which link, and what it touched; empty when nothing was touched.
        max_finger_force: largest normal force [N] of a static box on a finger.
        touched: names of everything that the arm or the gripper's body touched.
        rows: number of commanded rows of the trajectory, including the last one before a stop.
        stopped: the trajectory ended early because `max_force` reached `stop_above`, or because the tracking error
            exceeded MAX_ERROR.
    """

    time: float = 0.0
    max_error: float = 0.0
    max_force: float = 0.0
    max_force_link: str = ""
    max_force_against: str = ""
    max_finger_force: float = 0.0
    touched: set[str] = field(default_factory=set)
    rows: int = 0
    stopped: bool = False

    def __add__(self, other: MotionLog) -> MotionLog:
        """The log of both motions together."""
        harder = self if self.max_force >= other.max_force else other
        return MotionLog(
            time=self.time + other.time,
            max_error=max(self.max_error, other.max_error),
            max_force=harder.max_force,
            max_force_link=harder.max_force_link,
            max_force_against=harder.max_force_against,
            max_finger_force=max(self.max_finger_force, other.max_finger_force),
            touched=self.touched | other.touched,
            rows=self.rows + other.rows,
            stopped=self.stopped or other.stopped,
        )


@dataclass(frozen=True)
class JawState:
    """The jaws at rest.

    Attributes:
        opening: distance between the pads in [m].
        forces: normal force on the left and the right finger in [N].
        parts: indices of the workpieces that both fingers press on.
        log: what was touched meanwhile.
    """

    opening: float
    forces: tuple[float, float]
    parts: tuple[int, ...]
    log: MotionLog


def execute(world: World, arm: Arm, q: Array, stop_above: float | None = None) -> MotionLog:
    """Follow joint angles q (n, dof) [rad], one row per time step of the world.

    Args:
        stop_above: contact force [N] of the arm or the gripper's body at which the motion ends, as a controller's
            collision guard does; None for no limit.

    Raises:
        SimulationError: a target or a joint angle is not finite.
    """
    log = MotionLog()
    for row in np.atleast_2d(q):
        arm.command(row)
        log.rows += 1
        _step(world)
        error = float(np.abs(arm.q - row).max())
        log.max_error = max(log.max_error, error)
        _watch(world, arm, log)
        if not np.isfinite(error):
            raise SimulationError("a joint angle is not finite")
        if error > MAX_ERROR or (stop_above is not None and log.max_force > stop_above):
            log.stopped = True
            break
    if log.stopped:
        arm.command(arm.q)
    return log


def close_jaws(world: World, arm: Arm, timeout: float = 1.0, settle: float = CLOSE_SETTLE) -> JawState:
    """Close with the gripper's force until the fingers have stood still for `settle` [s], at most `timeout` [s]."""
    arm.drive_jaws(-arm.jaw.speed)
    log = _until_still(world, arm, timeout, settle)
    return JawState(arm.opening, finger_forces(world, arm), held_parts(world, arm), log)


def open_jaws(
    world: World, arm: Arm, opening: float | None = None, timeout: float = 1.0, settle: float = OPEN_SETTLE
) -> JawState:
    """Open the pads to `opening` [m] apart (all the way by default) and wait until the fingers stand still."""
    arm.hold_jaws(arm.gripper.max_opening if opening is None else opening)
    forget_contacts(world, arm)
    log = _until_still(world, arm, timeout, settle)
    return JawState(arm.opening, finger_forces(world, arm), held_parts(world, arm), log)


def jaw_times(jaw: ParallelJaw, opening: float, width: float, released: float) -> tuple[float, float]:
    """Times in [s] of `close_jaws` from `opening` onto a workpiece of `width`, and of `open_jaws` to `released` [m].

    The time in which the fingers accelerate is neglected; the time in which they settle on the workpiece is included.
    """
    close = (opening - width) / 2 / jaw.speed + CLOSE_EASE + CLOSE_SETTLE
    return close, (released - width) / 2 / jaw.speed + OPEN_EASE + OPEN_SETTLE


def forget_contacts(world: World, arm: Arm) -> None:
    """Drop the contact points between fingers and workpieces, for one step in which these do not collide.

    Bullet keeps a contact point with the world normal of the step in which it was found. While a held workpiece turns
    with the gripper, some of these normals become wrong, and two opposite ones fix the workpiece to one finger. The
    next step finds new points wherever there is contact.
    """
    touching = [c for link in arm.finger_links for c in world.client.getContactPoints(bodyA=arm.body, linkIndexA=link)]
    pairs = {(c[3], c[2]) for c in touching if c[2] in world.parts}
    for enable in (0, 1):
        for link, body in sorted(pairs):
            world.client.setCollisionFilterPair(arm.body, body, link, -1, enable)
        if not enable:
            world.step()


def wait(world: World, arm: Arm, seconds: float) -> MotionLog:
    """Advance the simulation with the last commands of arm and jaws."""
    log = MotionLog()
    for _ in range(round(seconds / world.dt)):
        _step(world)
        _watch(world, arm, log)
    return log


def finger_forces(world: World, arm: Arm) -> tuple[float, float]:
    """Force in [N] that presses the left and the right pad outwards."""
    axis = arm.tool_pose()[:3, 0]
    left, right = (sum(f @ axis for f in _on_finger(world, arm, link).values()) for link in arm.finger_links)
    return max(-float(left), 0.0), max(float(right), 0.0)


def held_parts(world: World, arm: Arm) -> tuple[int, ...]:
    """Indices of the workpieces on which both fingers press with at least HELD_FORCE, in order."""
    axis = arm.tool_pose()[:3, 0]
    left, right = (_on_finger(world, arm, link) for link in arm.finger_links)
    held = {body for body, force in left.items() if -(force @ axis) > HELD_FORCE}
    held &= {body for body, force in right.items() if force @ axis > HELD_FORCE}
    return tuple(i for i, body in enumerate(world.parts) if body in held)


def _step(world: World) -> None:
    world.step()
    if world.steps % DOZE_EVERY == 0:
        world.doze()


def _until_still(world: World, arm: Arm, timeout: float, settle: float) -> MotionLog:
    log, still = MotionLog(), 0.0
    while log.time < timeout and still < settle:
        _step(world)
        log.time += world.dt
        _watch(world, arm, log, counted=False)
        slow = max(abs(v) for v in arm.finger_speeds) < STILL
        still = still + world.dt if slow and log.time > 0.03 else 0.0
    return log


def _watch(world: World, arm: Arm, log: MotionLog, counted: bool = True) -> None:
    """Add the contacts of the last step to the log."""
    if counted:
        log.time += world.dt
    contacts = world.client.getContactPoints(bodyA=arm.body)
    if not contacts:
        return
    fingers, static = arm.finger_links, world.boxes.values()
    sums: dict[tuple[int, int], float] = {}
    for c in contacts:
        if c[8] <= 0:  # Bullet also lists pairs that are close but do not touch
            key = (c[3], c[2])
            sums[key] = sums.get(key, 0.0) + c[9]
    for (link, body), force in sums.items():
        if link in fingers:
            if body in static:
                log.max_finger_force = max(log.max_finger_force, force)
            continue
        name = world.name_of(body)
        log.touched.add(name)
        if force >= log.max_force:
            log.max_force, log.max_force_link, log.max_force_against = force, arm.link_names[link], name


def _on_finger(world: World, arm: Arm, link: int) -> dict[int, Array]:
    """Normal force (3,) [N] in world axes of each body on a finger."""
    out: dict[int, Array] = {}
    for c in world.client.getContactPoints(bodyA=arm.body, linkIndexA=link):
        out[c[2]] = out.get(c[2], np.zeros(3)) + c[9] * np.asarray(c[7])
    return out
