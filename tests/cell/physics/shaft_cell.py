"""The heavy shaft: lifted from the table by a jaw across its hub, and carried round."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pickproof.cell.frames import Array, apply, invert, make_transform, rotation_angle
from pickproof.cell.geometry.bin import table
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.picture import cell_picture
from pickproof.cell.physics.trajectory_execution import MotionLog, close_jaws, execute, held_parts, wait
from pickproof.cell.physics.world import World
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.robots.kinematics.inverse import inverse
from pickproof.robots.kinematics.model import load_robot

HUB = -0.045  # [m] along the shaft's axis, between gear and step: 5 mm from its centre of mass
AT = (0.42, 0.0)
FLIP = np.diag([-1.0, -1.0, 1.0])  # the turn of the tool that keeps J6 far from its limits
WAY = ((0.0, 0.0, 0.20), (0.0, 0.15, 0.25), (-0.1, -0.15, 0.20), (0.0, 0.1, 0.15), (0.0, 0.0, 0.20))


@dataclass(frozen=True)
class Carried:
    """What came of it: whether it was held to the end, the largest slip of the centre of mass [m] and turn [deg].

    `lift` holds slip and turn in the lift alone; `trace` (n, 3) is time, slip, turn.
    """

    held: bool
    slip: float
    turn_deg: float
    lift: tuple[float, float]
    trace: Array
    log: MotionLog
    picture: np.ndarray | None


def carry_shaft(
    gripper: ParallelJaw,
    acceleration: float = 8.0,
    friction: float | None = None,
    dt: float = 1 / 480,
    picture: bool = False,
) -> Carried:
    """Grip the shaft where it lies on the table, lift it and carry it round at an acceleration [m/s2] of the tool."""
    part = load_workpiece("gear_shaft")
    part = part if friction is None else replace(part, friction=friction)
    robot, world = load_robot("lrmate200id"), World(dt)
    world.add_box(table((1.6, 1.6, 0.04), (0.3, 0.0, 0.0)))
    lying = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # its axis along world y
    world.add_part(part, make_transform(lying, (*AT, 0.0505)))
    world.run_until_rest(3.0)
    arm = Arm(world, robot.urdf, robot.joints, gripper)
    T_world_part = world.part_pose(0)
    y = T_world_part[:3, 2]
    z = -np.array([0.0, 0.0, 1.0]) + y * y[2]  # straight down, as far as the tilted axis allows
    z /= np.linalg.norm(z)
    R = np.stack([np.cross(y, z), y, z], axis=1) @ FLIP
    above_tip = gripper.groove.above_tip if gripper.groove else 0.018
    hub = apply(T_world_part, np.array([[0.0, 0.0, HUB]]))[0]
    grasp = make_transform(R, hub + above_tip * z)
    trace: list[tuple[float, float, float]] = []
    mark = np.eye(4)

    def to(T: Array, acceleration: float, watch: bool) -> MotionLog:
        T_from, log = arm.tool_pose(), MotionLog()
        way = T[:3, 3] - T_from[:3, 3]
        duration = np.sqrt(10 / np.sqrt(3) * np.linalg.norm(way) / acceleration)
        s = np.linspace(0, 1, int(np.ceil(duration / world.dt)) + 1)[1:, None]
        s = s**3 * (10 - 15 * s + 6 * s * s)
        q = inverse(robot, make_transform(R, T_from[:3, 3] + s * way) @ invert(gripper.T_flange_tool), arm.q).q[:, 0]
        for k in range(0, len(q), 8):
            log += execute(world, arm, q[k : k + 8])
            if watch:
                moved = invert(mark) @ invert(arm.tool_pose()) @ world.part_pose(0)
                slip = np.linalg.norm(apply(moved, part.com[None])[0] - part.com)
                trace.append((world.time, float(slip), float(np.rad2deg(rotation_angle(moved[:3, :3])))))
        return log

    start = grasp @ make_transform(t=(0.0, 0.0, -0.08))
    arm.reset(inverse(robot, (start @ invert(gripper.T_flange_tool))[None]).q[0, 0])
    log = to(grasp, 3.0, watch=False)
    close_jaws(world, arm)
    mark = invert(arm.tool_pose()) @ world.part_pose(0)
    log += to(make_transform(R, (*AT, WAY[0][2])), acceleration, watch=True)
    lift = trace[-1][1:]
    image = cell_picture(world, (0.78, 0.34, 0.30), (0.42, -0.01, 0.20), 720, 540) if picture else None
    for x, y_, z_ in WAY[1:]:
        log += to(make_transform(R, (AT[0] + x, AT[1] + y_, z_)), acceleration, watch=True)
    wait(world, arm, 0.5)
    still_held = held_parts(world, arm) == (0,)
    world.close()
    rows = np.array(trace)
    return Carried(still_held, float(rows[:, 1].max()), float(rows[:, 2].max()), lift, rows, log, image)
