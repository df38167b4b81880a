"""The arm with its gripper: one articulated body with servo joints and compliant fingers or faces."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pickproof.cell.errors import InputError, SimulationError
from pickproof.cell.frames import Array, from_quat_xyzw, make_transform, to_quat_xyzw
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.one_sided import OneSidedGripper
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.physics._pybullet import pybullet
from pickproof.cell.physics.arm_urdf import merged_urdf
from pickproof.cell.physics.breakable_joint import Connection
from pickproof.cell.physics.world import World, engine_friction

GEAR_FORCE = 1e4  # [N] that keeps the fingers symmetric
# [N] largest force on the locked slide of cups or magnets while they hold: evacuated bellows are stiff
LOCK_FORCE = 2e3


class Arm:
    """An arm and a gripper in a world.

    Attributes:
        body: PyBullet's body id; used within `cell` only.
        gripper: what is mounted.
        joint_names: order of every q.
        connections: workpieces that cups or magnets hold; see `cell.physics.grip`.
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
        self.connections: list[Connection] = []
        self._lock = 0.0
        client = world.client
        base = np.eye(4) if T_world_base is None else T_world_base
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE  # no self-collision: the planner sees to that
        if isinstance(gripper, OneSidedGripper):
            flags |= pybullet.URDF_USE_IMPLICIT_CYLINDER  # faces end where they should, not 1 mm further
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "arm.urdf"
            path.write_text(merged_urdf(urdf, gripper, flange), encoding="utf-8")
            where = base[:3, 3].tolist(), to_quat_xyzw(base).tolist()
            self.body = int(client.loadURDF(str(path), *where, useFixedBase=True, flags=flags))
        self._find_joints(urdf, flange)
        self._set_finger_contact()
        if isinstance(gripper, ParallelJaw):
            self._gear()
        else:
            world.after_step.append(self._after_step)
        self.reset(np.zeros(len(self._joints)))

    def _find_joints(self, urdf: Path, flange: str) -> None:
        """Indices and torques of the joints by name; their friction and damping are switched off."""
        client, gripper = self.world.client, self.gripper
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
        self._fingers = [joints[f"{link.name}_joint"] for link in gripper.links()]
        self._flange = links[flange]
        self.link_names = {-1: "base", **{index: name for name, index in links.items()}}

    def _set_finger_contact(self) -> None:
        """Friction of the fingers, and stiffness and damping of soft pads."""
        client = self.world.client
        for finger, link in zip(self._fingers, self.gripper.links(), strict=True):
            client.changeDynamics(
                self.body,
                finger,
                lateralFriction=engine_friction(link.friction),
                spinningFriction=0.001,
                rollingFriction=0.0,
                restitution=0.0,
                frictionAnchor=1,
            )
            if link.pad is not None:
                client.changeDynamics(
                    self.body, finger, contactStiffness=link.pad.stiffness, contactDamping=link.pad.damping
                )

    @property
    def finger_links(self) -> tuple[int, ...]:
        """Link indices of what may touch workpieces: both fingers, or the slide with the faces."""
        return tuple(self._fingers)

    def reset(self, q: ArrayLike, opening: float | None = None) -> None:
        """Put the arm at joint angles q (n,) [rad] at rest, its pads `opening` [m] apart (all the way by default).

        A workpiece held by cups or magnets is released at its place.
        """
        q = self._checked(q)
        self.let_go()
        half = (self.gripper.max_opening if opening is None else opening) / 2
        for joint, angle in zip(self._joints, q, strict=True):
            self.world.client.resetJointState(self.body, joint, angle, 0.0)
        for finger in self._fingers:
            self.world.client.resetJointState(self.body, finger, half, 0.0)
        self.command(q)
        self.hold_jaws(2 * half)

    def command(self, q: ArrayLike) -> None:
        """Set the servo's target (n,) [rad] for the next step.

        With kp = kd = 1 and target velocity 0 the motor constraint sets the velocity (target - q) / dt, so the target
        is reached in one step; a feed-forward velocity would be added twice. The torque is limited to the URDF's
        effort.

        Raises:
            SimulationError: a target is not finite (after one NaN the arm never recovers).
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
        jaw = self.jaw
        if not np.isfinite(velocity):
            raise SimulationError(f"finger velocity {velocity} is not finite")
        self.world.client.setJointMotorControlArray(
            self.body,
            self._fingers,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=[velocity, velocity],
            forces=[jaw.force] * 2,
        )

    def hold_jaws(self, opening: float) -> None:
        """Servo the pads to `opening` [m] at the gripper's speed and at most its force; no effect without jaws."""
        half = float(self._checked([opening])[0]) / 2
        if not isinstance(self.gripper, ParallelJaw):
            return
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

    def attach(self, connection: Connection) -> None:
        """Attach a workpiece to cups or magnets; their slide is locked in place while they hold any."""
        self.connections.append(connection)
        self._lock = self.travel
        self._drive_slide()

    def let_go(self) -> None:
        """Release everything that cups or magnets hold."""
        for connection in self.connections:
            connection.release()
        self.connections.clear()

    @property
    def jaw(self) -> ParallelJaw:
        """The gripper, which must be a jaw; raises TypeError where it is none."""
        if not isinstance(self.gripper, ParallelJaw):
            raise TypeError(f"{self.gripper.name} has no jaws")
        return self.gripper

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

    def face_pose(self) -> Array:
        """T_world_tool (4, 4) of the TCP, moved by the compression of the springs behind cups or magnets."""
        return self.tool_pose() @ make_transform(t=(0.0, 0.0, -self.travel))

    def _gear(self) -> None:
        client, (left, right) = self.world.client, self._fingers
        gear = client.createConstraint(
            self.body, left, self.body, right, pybullet.JOINT_GEAR, [1, 0, 0], [0] * 3, [0] * 3
        )
        client.changeConstraint(gear, gearRatio=-1, maxForce=GEAR_FORCE, erp=0.5)

    @property
    def travel(self) -> float:
        """Compression in [m] of the springs behind the faces of cups or magnets."""
        return float(self.world.client.getJointState(self.body, self._fingers[0])[0])

    def _after_step(self) -> None:
        """Check the connections, and set the force of the spring behind the faces for the next step."""
        for connection in self.connections:
            connection.check()
        self._drive_slide()

    def _drive_slide(self) -> None:
        assert isinstance(self.gripper, OneSidedGripper)
        holding = any(connection.alive for connection in self.connections)
        self.world.client.setJointMotorControl2(
            self.body,
            self._fingers[0],
            pybullet.POSITION_CONTROL,
            targetPosition=self._lock if holding else 0.0,
            targetVelocity=0.0,
            positionGain=1.0 if holding else 0.2,
            velocityGain=1.0,
            force=LOCK_FORCE if holding else self.gripper.spring_force(self.travel),
        )

    def _checked(self, values: ArrayLike) -> Array:
        values = np.asarray(values, dtype=np.float64)
        if not np.isfinite(values).all():
            raise SimulationError(f"a motor target is not finite: {values.tolist()}")
        return values
