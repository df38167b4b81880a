"""Taking, holding and letting go, the same three calls for every kind of gripper.

How hard it grips is in the gripper's file (`cell/grippers/*.yaml`); `Arm.drive_jaws` hands a jaw's force to PyBullet.
"""

from __future__ import annotations

from dataclasses import dataclass

from pickproof.cell.grippers.one_sided import OneSidedGripper
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.breakable_joint import Connection
from pickproof.cell.physics.contact_probe import probe
from pickproof.cell.physics.trajectory_execution import MotionLog, close_jaws, held_parts, open_jaws, wait
from pickproof.cell.physics.world import World


@dataclass(frozen=True)
class Grip:
    """Result of gripping or releasing.

    Attributes:
        parts: indices of the workpieces that are held.
        log: what was touched meanwhile.
        faces: for each cup or magnet why it holds nothing, empty where it holds; () for a jaw.
    """

    parts: tuple[int, ...]
    log: MotionLog
    faces: tuple[str, ...] = ()


def grip(world: World, arm: Arm) -> Grip:
    """Close the jaws, or switch on vacuum or magnet, at the current pose of the arm."""
    if isinstance(arm.gripper, ParallelJaw):
        jaws = close_jaws(world, arm)
        return Grip(jaws.parts, jaws.log)
    gripper = _one_sided(arm)
    arm.let_go()
    log = wait(world, arm, gripper.switch_time)
    T = arm.face_pose()
    holds, faces = gripper.take(
        lambda points: probe(world, T, points), lambda i: world.workpieces[i].magnetic, arm.travel
    )
    for part, own in sorted(holds.items()):
        arm.attach(Connection(world, arm.body, arm.finger_links[0], part, own, T))
    return Grip(held(world, arm), log, faces)


def release(world: World, arm: Arm, opening: float | None = None) -> Grip:
    """Open the jaws to `opening` [m] (all the way by default), or switch off until vacuum or field is gone."""
    world.unanchor(held(world, arm))
    if isinstance(arm.gripper, ParallelJaw):
        jaws = open_jaws(world, arm, opening)
        return Grip(jaws.parts, jaws.log)
    log = wait(world, arm, _one_sided(arm).switch_time)
    arm.let_go()
    return Grip(held(world, arm), log)


def held(world: World, arm: Arm) -> tuple[int, ...]:
    """Indices of the workpieces that the gripper holds now, in order."""
    if isinstance(arm.gripper, ParallelJaw):
        return held_parts(world, arm)
    return tuple(sorted(c.part for c in arm.connections if c.alive))


def _one_sided(arm: Arm) -> OneSidedGripper:
    assert isinstance(arm.gripper, OneSidedGripper)
    return arm.gripper
