"""The arm with its gripper: one articulated body whose joints are servoed and whose fingers are force-limited."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cell._pybullet import pybullet
from cell.errors import InputError, SimulationError
from cell.frames import Array, from_quat_xyzw, to_quat_xyzw
from cell.gripper import Gripper
from cell.urdf import FINGERS, merged_urdf
from cell.world import World, engine_friction

GEAR_FORCE = 1e4  # [N] that keeps the fingers symmetric


class Arm:
    """An arm and a parallel jaw in a world.

    Attributes:
        body: PyBullet's body id; used within `cell` only.
        gripper: what is mounted.
        joint_names: order of every q.
    """

    def __init__(
        self,
        world: World,
        urdf: Path,
        joint_names: tuple[str, ...],
        gripper: Gripper,
        T_world_base: Array | None = None,
        flange: str = "tool0",
    ) -> None:
        """Load `urdf` with the gripper under its link `flange`, standing at joint zero and open.

        Raises:
            InputError: the URDF is not readable, or lacks a joint or the flange link.
        """
        self.world, self.gripper, self.joint_names = world, gripper, tuple(joint_names)
        client = world.client
        base = np.eye(4) if T_world_base is None else T_world_base
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "arm.urdf"
            path.write_text(merged_urdf(urdf, gripper, flange), encoding="utf-8")
            self.body = int(
                client.loadURDF(
                    str(path),
                    base[:3, 3].tolist(),
                    to_quat_xyzw(base).tolist(),
                    useFixedBase=True,
                    flags=pybullet.URDF_USE_INERTIA_FROM_FILE,  # no self-collision: the planner sees to that
                )
            )
        joints, links, efforts = {}, {}, {}
        for j in range(client.getNumJoints(self.body)):
            info = client.getJointInfo(self.body, j)
            joints[info[1].decode()], links[info[12].decode()] = j, j
            efforts[info[1].decode()] = float(info[10])
            client.setJointMotorControl2(self.body, j, pybullet.VELOCITY_CONTROL, force=0)  # frictionless
            client.changeDynamics(self.body, j, linearDamping=0, angularDamping=0, jointDamping=0)
        for name in self.joint_names:
            if name not in joints:
                raise InputError(urdf, "joint", name, f"one of: {', '.join(joints)}")
            if efforts[name] <= 0:
                raise InputError(urdf, f"effort of joint {name}", efforts[name], "a positive torque in [N m]")
        self._joints = [joints[name] for name in self.joint_names]
        self._torques = [efforts[name] for name in self.joint_names]
        self._fingers = [joints[f"{name}_joint"] for name in FINGERS]
        self._flange = links[flange]
        self.link_names = {-1: "base", **{index: name for name, index in links.items()}}
        for finger in self._fingers:
            client.changeDynamics(
                self.body,
                finger,
                lateralFriction=engine_friction(gripper.friction),
                spinningFriction=0.001,
                rollingFriction=0.0,
                restitution=0.0,
                frictionAnchor=1,
            )
        self._gear = client.createConstraint(
            self.body, self._fingers[0], self.body, self._fingers[1], pybullet.JOINT_GEAR, [1, 0, 0], [0] * 3, [0] * 3
        )
        client.changeConstraint(self._gear, gearRatio=-1, maxForce=GEAR_FORCE, erp=0.5)
        self.reset(np.zeros(len(self._joints)))

    @property
    def finger_links(self) -> tuple[int, int]:
        """Link indices of both fingers."""
        return self._fingers[0], self._fingers[1]

    def reset(self, q: ArrayLike, opening: float | None = None) -> None:
        """Put the arm at joint angles q (n,) [rad] at rest, its pads `opening` [m] apart (all the way by default)."""
        q = self._checked(q)
        half = (self.gripper.max_opening if opening is None else opening) / 2
        for joint, angle in zip(self._joints, q, strict=True):
            self.world.client.resetJointState(self.body, joint, angle, 0.0)
        for finger in self._fingers:
            self.world.client.resetJointState(self.body, finger, half, 0.0)
        self.command(q)
        self.hold_jaws(2 * half)

    def command(self, q: ArrayLike) -> None:
        """Set the servo's target (n,) [rad] for the next step.

        With kp = kd = 1 and target velocity 0 the motor constraint asks for (target - q) / dt, so the target is
        reached in one step; a feed-forward velocity would count twice. The torque is limited to the URDF's effort.

        Raises:
            SimulationError: a target is not finite (one NaN would poison the arm for good).
        """
        n = len(self._joints)
        self.world.client.setJointMotorControlArray(
            self.body,
            self._joints,
            pybullet.POSITION_CONTROL,
            targetPositions=self._checked(q).tolist(),
            targetVelocities=[0.0] * n,
            forces=self._torques,
            positionGains=[1.0] * n,
            velocityGains=[1.0] * n,
        )

    def drive_jaws(self, velocity: float) -> None:
        """Drive each finger outwards (positive) or inwards at `velocity` [m/s] with at most the gripper's force."""
        if not np.isfinite(velocity):
            raise SimulationError(f"finger velocity {velocity} is not finite")
        self.world.client.setJointMotorControlArray(
            self.body,
            self._fingers,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=[velocity, velocity],
            forces=[self.gripper.force] * 2,
        )

    def hold_jaws(self, opening: float) -> None:
        """Servo the pads to `opening` [m] apart at the gripper's speed, with at most its force."""
        half = float(self._checked([opening])[0]) / 2
        for finger in self._fingers:
            self.world.client.setJointMotorControl2(
                self.body,
                finger,
                pybullet.POSITION_CONTROL,
                targetPosition=half,
                targetVelocity=0.0,
                positionGain=0.2,
                velocityGain=1.0,
                force=self.gripper.force,
                maxVelocity=self.gripper.speed,
            )

    @property
    def q(self) -> Array:
        """Joint angles (n,) in [rad]."""
        states = self.world.client.getJointStates(self.body, self._joints)
        return np.array([s[0] for s in states])

    @property
    def opening(self) -> float:
        """Distance between the pads in [m]."""
        return float(sum(s[0] for s in self.world.client.getJointStates(self.body, self._fingers)))

    @property
    def finger_speeds(self) -> tuple[float, float]:
        """Outward speeds of both fingers in [m/s]."""
        left, right = self.world.client.getJointStates(self.body, self._fingers)
        return float(left[1]), float(right[1])

    def tool_pose(self) -> Array:
        """T_world_tool (4, 4) of the TCP."""
        state = self.world.client.getLinkState(self.body, self._flange, computeForwardKinematics=True)
        return from_quat_xyzw(state[4], state[5]) @ self.gripper.T_flange_tool

    def _checked(self, values: ArrayLike) -> Array:
        values = np.asarray(values, dtype=np.float64)
        if not np.isfinite(values).all():
            raise SimulationError(f"a motor target is not finite: {values.tolist()}")
        return values
