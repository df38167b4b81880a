"""Experiments in the physics with a closed form: shared by the tests and docs/measurements/physics.md.

Every function runs real PyBullet and returns what it measured; the tests hold it against the law.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pickproof.cell.frames import Array, apply, from_rpy, invert, make_transform, random_rotations
from pickproof.cell.geometry.bin import Bin, Box, table
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.trajectory_execution import close_jaws, execute, finger_forces, wait
from pickproof.cell.physics.world import World
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.robots.kinematics.inverse import inverse
from pickproof.robots.kinematics.model import load_robot
from tests.cell.grippers.one_sided_cell import DOWN, FACE
from tests.cell.workpiece.solids import block, rod


def jaw(name: str = "jaw_v1", **changes: object) -> ParallelJaw:
    """A shipped jaw with other numbers."""
    gripper = load_gripper(name)
    assert isinstance(gripper, ParallelJaw)
    return replace(gripper, **changes)  # type: ignore[arg-type]


def jaws_on(gripper: ParallelJaw, part: Workpiece, T_tool_part: Array, **options: float) -> tuple[World, Arm]:
    """The arm over the table has closed on a workpiece that was held in the air until then."""
    robot, world = load_robot("lrmate200id"), World(**options)
    arm = Arm(world, robot.urdf, robot.joints, gripper)
    tool = make_transform(DOWN, FACE)
    arm.reset(inverse(robot, tool[None] @ invert(gripper.T_flange_tool)).q[0, 0])
    world.client.setGravity(0, 0, 0)
    world.add_part(part, tool @ T_tool_part)
    close_jaws(world, arm)
    world.client.setGravity(0, 0, -9.81)
    return world, arm


def slip_of_a_grip(load_share: float, friction: float = 0.3, force: float = 40.0, seconds: float = 0.5) -> float:
    """How far in [m] a block of 0.2 kg slides between the pads under `load_share` of what friction carries, 2 mu F.

    The load is the weight and a pull along it, raised within 0.1 s.
    """
    gripper = jaw(force=force, friction=friction)
    part = block((0.02, 0.03, 0.03), 0.2, friction)
    world, arm = jaws_on(gripper, part, make_transform(t=(0.0, 0.0, -0.005)))
    wait(world, arm, 0.1)
    start = world.part_pose(0)[2, 3]
    pull = load_share * 2 * friction * force - part.mass * 9.81
    for k in range(round(seconds / world.dt)):
        at = world.part_pose(0)[:3, 3]
        f = [0.0, 0.0, -pull * min(1.0, k / 48)]
        world.client.applyExternalForce(world.parts[0], -1, f, at.tolist(), world.client.WORLD_FRAME)
        world.step()
    slip = float(start - world.part_pose(0)[2, 3])
    world.close()
    return slip


def pad_forces(force: float) -> tuple[float, float]:
    """What the two pads read in [N] on a block held at rest."""
    world, arm = jaws_on(jaw(force=force), block((0.02, 0.03, 0.03), 0.1), make_transform(t=(0.0, 0.0, -0.005)))
    wait(world, arm, 0.2)
    read = finger_forces(world, arm)
    world.close()
    return read


def fall(seconds: float = 0.5) -> tuple[Array, Array]:
    """Times [s] and distances [m] fallen from rest."""
    world = World()
    world.add_part(block((0.03, 0.03, 0.03), 0.1), make_transform(t=(0.0, 0.0, 2.0)))
    t, z = [], []
    for _ in range(round(seconds / world.dt)):
        world.step()
        t.append(world.time)
        z.append(2.0 - world.part_pose(0)[2, 3])
    world.close()
    return np.array(t), np.array(z)


def down_a_slope(part: Workpiece, angle: float, friction: float, seconds: float = 0.4) -> float:
    """Acceleration in [m/s2] of a workpiece from rest on a slope, whose axes at rest are those of the world."""
    world, T = World(), from_rpy(rpy=(0.0, angle, 0.0))
    world.add_box(Box("slope", (3.0, 0.6, 0.1), T @ make_transform(t=(0.0, 0.0, -0.05))), friction=friction)
    start = T @ make_transform(t=(-1.0, 0.0, part.extents[2] / 2))
    world.add_part(replace(part, friction=friction), start)
    world.run(seconds)
    travel = invert(T)[:3, :3] @ (world.part_pose(0) - start)[:3, 3]
    world.close()
    return float(2 * travel[0] / seconds**2)


def roller(radius: float = 0.03, length: float = 0.08, mass: float = 0.5, friction: float = 0.5) -> Workpiece:
    """A cylinder whose axis lies along y: it rolls along x."""
    part = rod(radius, length, mass, friction)
    turn = from_rpy(rpy=(0.0, 0.0, np.pi / 2))
    (piece,) = part.collision_cylinders
    return replace(
        part,
        vertices=apply(turn, part.vertices),
        inertia=turn[:3, :3] @ part.inertia @ turn[:3, :3].T,
        collision_cylinders=(piece.model_copy(update={"rpy": (np.pi / 2, 0.0, 0.0)}),),
    )


def tracking(share_of_limits: float) -> tuple[Array, Array]:
    """Times [s] and largest joint error [rad] while all joints swing by 0.4 rad at a share of the arm's limits."""
    robot, world = load_robot("lrmate200id"), World()
    arm = Arm(world, robot.urdf, robot.joints, jaw())
    arm.reset(robot.home)
    duration = float(np.sqrt(0.4 * 10 / np.sqrt(3) / (share_of_limits * robot.acceleration.min())))
    t = np.arange(1, int(duration / world.dt) + 1) * world.dt
    s = t / duration
    swing = 0.4 * s**3 * (10 - 15 * s + 6 * s * s)
    errors = []
    for row in robot.home + swing[:, None] * np.array([1, 1, -1, 1, 1, 1]):
        errors.append(execute(world, arm, row).max_error)
    world.close()
    return t, np.array(errors)


def stack(count: int = 6, seconds: float = 10.0) -> tuple[Array, Array]:
    """Times [s] and the largest drift [m] of any of `count` blocks that stand on each other, none put to sleep."""
    world = World()
    world.add_box(table((1.0, 1.0, 0.05), (0.0, 0.0, 0.0)))
    for i in range(count):
        world.add_part(block((0.05, 0.05, 0.03), 0.3), make_transform(t=(0.0, 0.0, 0.015 + 0.03 * i)))
    world.run(0.1)
    start = world.part_poses()[:, :3, 3]
    t, drift = [], []
    for _ in range(round(seconds / 0.1)):
        world.run(0.1)
        for i in range(count):
            world.wake(i)
        t.append(world.time)
        drift.append(np.linalg.norm(world.part_poses()[:, :3, 3] - start, axis=1).max())
    world.close()
    return np.array(t), np.array(drift)


def drops(count: int = 100, speed: float = 3.0, seed: int = 0) -> tuple[Array, float, int]:
    """Brackets flung at floor and walls of a bin at up to `speed` [m/s], one after another.

    Returns where they came to rest in the bin's frame (n, 3), the deepest contact seen in [m], and how many were not
    inside.
    """
    rng, bin, world = np.random.default_rng(seed), Bin("bin", (0.30, 0.22, 0.40), 0.006, (0.0, 0.0, 0.006)), World()
    world.add_bin(bin)
    part = load_workpiece("bracket")
    world.add_part(part, make_transform(t=(0.0, 0.0, 0.3)))
    ends, deepest = [], 0.0
    for _ in range(count):
        world.place_part(0, make_transform(random_rotations(1, rng)[0], (0.0, 0.0, 0.25)))
        world.wake(0)
        yaw, down = rng.uniform(0, 2 * np.pi), rng.uniform(0.2, 1.0)
        v = rng.uniform(0.5, 1.0) * speed * np.array([np.cos(yaw), np.sin(yaw), -down])
        world.client.resetBaseVelocity(world.parts[0], v.tolist(), rng.normal(size=3).tolist())
        for _ in range(round(0.5 / world.dt)):
            world.step()
            contacts = world.client.getContactPoints(bodyA=world.parts[0])
            deepest = max([deepest, *(-c[8] for c in contacts)])
        ends.append(apply(invert(bin.T_world_bin), world.part_pose(0)[:3, 3][None])[0])
    where = np.array(ends)
    inside = (np.abs(where[:, :2]) < np.array(bin.inner[:2]) / 2).all(1) & (where[:, 2] > 0)
    world.close()
    return where, deepest, int((~inside).sum())
