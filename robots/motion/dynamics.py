"""Load checks of the arm: payload, and the torques of a trajectory by inverse dynamics (Pinocchio)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pickproof.cell.frames import Array
from pickproof.robots.failure import Cause, Refusal
from pickproof.robots.kinematics.model import RobotModel
from pickproof.robots.motion.timing import Motion
from pickproof.robots.motion.trajectory import Trajectory

CHECKED, EACH = 64, 4  # number of times at which the torques of a motion are checked; steps between them
TORQUE_MARGIN = 0.95  # share of the limits, as a reserve for times in between


@dataclass(frozen=True, eq=False)
class Load:
    """Load on the flange (gripper and workpiece): mass in [kg], centre of mass (3,) in the flange frame in [m]."""

    mass: float
    centre: Array

    def __add__(self, other: Load) -> Load:
        """The combined load."""
        mass = self.mass + other.mass
        return Load(mass, (self.mass * self.centre + other.mass * other.centre) / mass if mass else self.centre)


def overload(robot: RobotModel, load: Load) -> str:
    """The reason why the arm may not carry a load at all; empty where it may."""
    return f"{load.mass:.1f} kg exceeds the payload of {robot.payload:.1f} kg" if load.mass > robot.payload else ""


def torques(robot: RobotModel, trajectory: Trajectory, load: Load | None = None) -> Array:
    """Joint torques (n - 2, 6) in [N m] at the inner samples of a trajectory, gravity along -z, the load a point mass.

    Accelerations are central differences of the velocities. Friction and the inertia of motors and gears are left out.
    """
    model = robot.kinematics if load is None else _loaded(robot, load)
    data = model.createData()
    acceleration = (trajectory.qd[2:] - trajectory.qd[:-2]) / (2 * trajectory.dt)
    rows = zip(trajectory.q[1:-1], trajectory.qd[1:-1], acceleration, strict=True)
    return np.array([pin.rnea(model, data, q, v, a) for q, v, a in rows]).reshape(-1, 6)


def bearable(robot: RobotModel, motion: Motion, scale: float, load: Load | None = None) -> float | Refusal:
    """Largest time scale of a motion within the torque limits, at most `scale`; or the joint that cannot hold the load.

    Torques of gravity are constant; torques of the motion grow with the square of the scale.
    """
    model = robot.kinematics if load is None else _loaded(robot, load)
    data, still = model.createData(), np.zeros(6)
    step = motion.duration / (CHECKED * EACH)
    q, qd = motion.sampled(step)
    q, qd, acceleration = (rows[::EACH] for rows in (q, qd, np.gradient(qd, step, axis=0)))
    limit = TORQUE_MARGIN * robot.effort
    gravity = np.array([pin.rnea(model, data, x, still, still) for x in q])
    room = limit - np.abs(gravity)
    if (room <= 0).any():
        return Refusal(Cause.TORQUE, joint=int(np.argmin(room.min(axis=0))) + 1)
    moving = np.array([pin.rnea(model, data, *row) for row in zip(q, qd, acceleration, strict=True)]) - gravity
    # |gravity + scale^2 moving| <= limit on the side that is reached first
    room = np.where(moving * gravity >= 0, room, limit + np.abs(gravity))
    return float(min(scale, np.sqrt((room / np.maximum(np.abs(moving), 1e-9)).min())))


def _loaded(robot: RobotModel, load: Load) -> pin.Model:
    model = robot.kinematics.copy()
    T_joint_flange = model.frames[robot.flange].placement
    model.appendBodyToJoint(
        model.njoints - 1, pin.Inertia(load.mass, np.asarray(load.centre), np.zeros((3, 3))), T_joint_flange
    )
    return model
