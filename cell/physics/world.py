"""The physics: one headless PyBullet client, the static boxes of the cell and the workpieces in it.

With these settings a workpiece held by friction alone does not creep (docs/explanation/physics.md): 1/480 s, friction
anchors on parts and fingers, frictionERP 0.8, deterministic overlapping pairs. Workpieces and boxes are rigid bodies in
maximal
coordinates: as multibodies without joints they take several times as long. The world is always rebuilt from scratch:
    saveState/restoreState is not exact for compound shapes and ignores a wrong body id silently.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pickproof.cell.errors import SimulationError
from pickproof.cell.frames import Array, from_quat_xyzw, invert, make_transform, to_quat_xyzw
from pickproof.cell.geometry.bin import Bin, Box
from pickproof.cell.physics._pybullet import connect, pybullet
from pickproof.cell.physics.collision_shape import collision_shape
from pickproof.cell.workpiece.workpiece import Workpiece

GRAVITY = 9.81  # [m/s2]
TIMESTEP = 1 / 480  # [s]
REST_LINEAR = 0.01  # [m/s] below which a workpiece counts as at rest
REST_ANGULAR = 0.3  # [rad/s]


def engine_friction(mu: float) -> float:
    """The coefficient to set for a body of friction `mu`, since Bullet multiplies the two of a contact.

    With the square root, the friction of a contact is the geometric mean of the two bodies: 0.5 for two steel parts of
        0.5, and 0.63 for a steel part on pads of 0.8.
    """
    return float(np.sqrt(mu))


class World:
    """A physics world in SI units, z up.

    Attributes:
        dt: time step in [s].
        time: simulated time in [s].
        client: the PyBullet client; used within `cell` only.
        parts: body ids of the workpieces in the order in which they were added; workpieces: what they are.
        held: indices of workpieces that must stay awake, since a connection moves them and not a contact.
        after_step: functions that are called after every step, in order, whatever code advances the world.
    """

    def __init__(self, dt: float = TIMESTEP, solver_iterations: int = 50) -> None:
        self.dt, self._solver_iterations = dt, solver_iterations
        self.client: Any = connect()
        self._begin()

    def restart(self) -> None:
        """Reset to an empty world at time 0, equal to a new one; a new client would leak 28 MB."""
        self.client.resetSimulation()
        self._begin()

    def _begin(self) -> None:
        self.client.setGravity(0, 0, -GRAVITY)
        self.client.setPhysicsEngineParameter(
            fixedTimeStep=self.dt,
            numSolverIterations=self._solver_iterations,
            numSubSteps=0,
            frictionERP=0.8,
            solverResidualThreshold=1e-7,
            deterministicOverlappingPairs=1,
        )
        self.steps = 0
        self.boxes: dict[str, int] = {}
        self.parts: list[int] = []
        self.workpieces: list[Workpiece] = []
        self.held: set[int] = set()
        self.after_step: list[Callable[[], None]] = []
        self._T_part_inertial: list[Array] = []
        self._names: dict[int, str] = {}
        self._quiet = np.zeros(0, dtype=bool)

    @property
    def time(self) -> float:
        """[s] of simulated time since the world was made."""
        return self.steps * self.dt

    def close(self) -> None:
        """Disconnect the client; the world cannot be used after."""
        self.client.disconnect()

    def add_box(self, box: Box, friction: float = 0.5) -> int:
        """Add a static box; returns its body id."""
        shape = self.client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[s / 2 for s in box.size])
        body = self.client.createMultiBody(
            0.0,
            shape,
            basePosition=box.T_world_box[:3, 3].tolist(),
            baseOrientation=to_quat_xyzw(box.T_world_box).tolist(),
            useMaximalCoordinates=True,
        )
        self.client.changeDynamics(body, -1, lateralFriction=engine_friction(friction), restitution=0.05)
        self.boxes[box.name] = int(body)
        self._names[int(body)] = box.name
        return int(body)

    def add_bin(self, bin: Bin, friction: float = 0.4) -> None:
        """Add floor and walls of a bin."""
        for box in bin.boxes():
            self.add_box(box, friction)

    def remove_box(self, name: str) -> None:
        """Remove a static box by name; raises KeyError when there is none."""
        body = self.boxes.pop(name)
        del self._names[body]
        self.client.removeBody(body)

    def name_of(self, body: int) -> str:
        """Name of a box, or `part <index>`."""
        return self._names.get(body, f"body {body}")

    def add_part(self, workpiece: Workpiece, T_world_part: Array) -> int:
        """Add a workpiece as a rigid body of collision pieces; returns its index in `parts`.

        Mass, centre of mass and the full inertia tensor are those of the CAD at its density.
        """
        moments, axes = np.linalg.eigh(workpiece.inertia)
        if np.linalg.det(axes) < 0:
            axes[:, 0] *= -1
        T_part_inertial = make_transform(axes, workpiece.com)
        # positions given to createMultiBody and read back are those of the inertial frame: the pieces are placed in it
        shape = collision_shape(self.client, workpiece.pieces, invert(T_part_inertial))
        T = T_world_part @ T_part_inertial
        body = self.client.createMultiBody(
            workpiece.mass,
            shape,
            basePosition=T[:3, 3].tolist(),
            baseOrientation=to_quat_xyzw(T).tolist(),
            useMaximalCoordinates=True,
        )
        self.client.changeDynamics(
            body,
            -1,
            mass=workpiece.mass,  # again: without it, setting the inertia of such a body sets its mass to zero
            lateralFriction=engine_friction(workpiece.friction),
            spinningFriction=0.001,
            rollingFriction=workpiece.rolling_friction,
            restitution=0.05,
            frictionAnchor=1,
            localInertiaDiagonal=moments.tolist(),
            linearDamping=0.04,
            angularDamping=0.04,
            activationState=pybullet.ACTIVATION_STATE_ENABLE_SLEEPING,
        )
        self._names[int(body)] = f"part {len(self.parts)}"
        self.parts.append(int(body))
        self.workpieces.append(workpiece)
        self._T_part_inertial.append(T_part_inertial)
        return len(self.parts) - 1

    @contextmanager
    def weightless(self) -> Iterator[None]:
        """Gravity off inside this context: a workpiece released in the air stays there."""
        self.client.setGravity(0, 0, 0)
        try:
            yield
        finally:
            self.client.setGravity(0, 0, -GRAVITY)

    def place_part(self, index: int, T_world_part: Array) -> None:
        """Teleport a workpiece at rest (filling the bin only; never during a pick)."""
        T = T_world_part @ self._T_part_inertial[index]
        body = self.parts[index]
        self.client.resetBasePositionAndOrientation(body, T[:3, 3].tolist(), to_quat_xyzw(T).tolist())
        self.client.resetBaseVelocity(body, [0, 0, 0], [0, 0, 0])

    def part_pose(self, index: int) -> Array:
        """T_world_part (4, 4) of one workpiece."""
        position, quat_xyzw = self.client.getBasePositionAndOrientation(self.parts[index])
        return from_quat_xyzw(position, quat_xyzw) @ invert(self._T_part_inertial[index])

    def part_poses(self) -> Array:
        """Ts_world_part (n, 4, 4).

        Raises:
            SimulationError: a pose is not finite.
        """
        if not self.parts:
            return np.zeros((0, 4, 4))
        Ts = np.stack([self.part_pose(i) for i in range(len(self.parts))])
        if not np.isfinite(Ts).all():
            raise SimulationError("a workpiece has a pose that is not finite")
        return Ts

    def part_speeds(self) -> Array:
        """Speeds (n, 2): linear [m/s] and angular [rad/s]."""
        out = np.zeros((len(self.parts), 2))
        for i, body in enumerate(self.parts):
            linear, angular = self.client.getBaseVelocity(body)
            out[i] = np.linalg.norm(linear), np.linalg.norm(angular)
        return out

    def step(self, n: int = 1) -> None:
        """Advance n time steps."""
        for _ in range(n):
            self.client.stepSimulation()
            for watch in self.after_step:
                watch()
        self.steps += n

    def run(self, seconds: float) -> None:
        """Advance by a time, rounded to whole steps."""
        self.step(round(seconds / self.dt))

    def at_rest(self) -> np.ndarray:
        """Which workpieces (n,) are slower than REST_LINEAR and REST_ANGULAR."""
        speeds = self.part_speeds()
        return (speeds[:, 0] < REST_LINEAR) & (speeds[:, 1] < REST_ANGULAR)

    def run_until_rest(self, limit: float, sleep: bool = True) -> bool:
        """Advance until every workpiece has been at rest for 100 ms, at most `limit` [s]; then put all to sleep.

        A sleeping workpiece needs almost no computation and wakes when touched; Bullet's own rule would wait 2 s.
        """
        quiet = 0
        for _ in range(round(limit / (24 * self.dt))):
            self.step(24)
            quiet = quiet + 1 if self.at_rest().all() else 0
            if quiet >= 2:
                if sleep:
                    self.sleep()
                return True
        return False

    def sleep(self) -> None:
        """Put every workpiece to sleep at its pose."""
        for i, body in enumerate(self.parts):
            if i not in self.held:
                self.client.changeDynamics(body, -1, activationState=pybullet.ACTIVATION_STATE_SLEEP)

    def wake(self, index: int) -> None:
        """Wake one workpiece; Bullet itself wakes only touched ones."""
        self.client.changeDynamics(self.parts[index], -1, activationState=pybullet.ACTIVATION_STATE_WAKE_UP)

    def unanchor(self, parts: Iterable[int]) -> None:
        """Switch off the friction anchors of released workpieces: with them, a workpiece on a floor rocks without end.

        An anchor pulls a contact point back to where it was found. In the gripper (fingers have their own anchors) and
        in a heap this prevents creep. A workpiece set down at an angle is driven from edge to edge
        (docs/explanation/physics.md).
        """
        for i in parts:
            self.client.changeDynamics(self.parts[i], -1, frictionAnchor=0)

    def doze(self) -> None:
        """Put workpieces to sleep that are at rest now and were at the last call; call it every 100 ms or so.

        In the next step Bullet wakes those whose heap touches a moving body, such as the fingers.
        """
        quiet = self.at_rest()
        if len(self._quiet) == len(quiet):
            for i in sorted(set(np.flatnonzero(quiet & self._quiet).tolist()) - self.held):
                self.client.changeDynamics(self.parts[i], -1, activationState=pybullet.ACTIVATION_STATE_SLEEP)
        self._quiet = quiet


def random_pose(centre: Sequence[float], half_span: tuple[float, float], rng: np.random.Generator) -> Array:
    """A pose with uniform rotation at a uniform horizontal offset of at most `half_span` [m] from `centre`."""
    offset = rng.uniform(-1.0, 1.0, 2) * half_span
    R = Rotation.from_quat(rng.standard_normal(4)).as_matrix()
    return make_transform(R, (centre[0] + offset[0], centre[1] + offset[1], centre[2]))
