"""Whether the arm can bear a load: its payload, and the torques of a trajectory by inverse dynamics (Pinocchio)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from cell.frames import Array
from robots.model import RobotModel
from robots.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Load:
    """What hangs on the flange, gripper and workpiece: mass in [kg], centre of mass (3,) in the flange frame in [m]."""

    mass: float
    centre: Array


def overload(robot: RobotModel, load: Load) -> str:
    """Why the arm may not carry a load at all; empty where it may."""
    return f"{load.mass:.1f} kg is more than the payload of {robot.payload:.1f} kg" if load.mass > robot.payload else ""


def torques(robot: RobotModel, trajectory: Trajectory, load: Load | None = None) -> Array:
    """Joint torques (n - 2, 6) in [N m] at the inner samples of a trajectory, gravity along -z, the load a point mass.

    Accelerations are central differences of the velocities. Friction and the inertia of motors and gears are left out.
    """
    model = robot.kinematics if load is None else _loaded(robot, load)
    data = model.createData()
    acceleration = (trajectory.qd[2:] - trajectory.qd[:-2]) / (2 * trajectory.dt)
    rows = zip(trajectory.q[1:-1], trajectory.qd[1:-1], acceleration, strict=True)
    return np.array([pin.rnea(model, data, q, v, a) for q, v, a in rows]).reshape(-1, 6)


def torque_share(robot: RobotModel, trajectory: Trajectory, load: Load | None = None) -> Array:
    """Largest torque of each joint (6,) as a share of its limit; above 1 the motor cannot follow."""
    if len(trajectory.q) < 3:
        return np.zeros(6)
    return np.asarray(np.abs(torques(robot, trajectory, load)).max(axis=0) / robot.effort)


def _loaded(robot: RobotModel, load: Load) -> pin.Model:
    model = robot.kinematics.copy()
    T_joint_flange = model.frames[robot.flange].placement
    model.appendBodyToJoint(
        model.njoints - 1, pin.Inertia(load.mass, np.asarray(load.centre), np.zeros((3, 3))), T_joint_flange
    )
    return model
