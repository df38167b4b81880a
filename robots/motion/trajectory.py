"""Joint trajectories sampled at a fixed rate: joint moves, straight tool lines, and the acceleration of the tool.

Every motion keeps the arm's velocity, acceleration and jerk limits. `scale` in (0, 1] slows a motion down in time and
keeps its path: velocities scale with it, accelerations with its square, jerks with its cube.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from pickproof.cell.frames import Array, make_transform
from pickproof.robots.failure import Cause, Refusal
from pickproof.robots.kinematics.inverse import SIGMA_MIN, branch, flange_poses, inverse
from pickproof.robots.kinematics.model import RobotModel
from pickproof.robots.motion.timing import JointPath, Motion, joint_segment, path_segment

DT = 1.0 / 480.0  # [s], the step of the physics
LINE_SAMPLES = 33
MAX_LINE_STEP = 0.5  # [rad] a joint may turn between two samples of a line before it counts as a flip


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Joint positions q (n, 6) in [rad] and velocities qd (n, 6) in [rad/s] every `dt` [s], the first at time 0."""

    name: str
    q: Array
    qd: Array
    dt: float

    def __post_init__(self) -> None:
        self.q.flags.writeable = self.qd.flags.writeable = False

    @property
    def duration(self) -> float:
        """In [s]."""
        return (len(self.q) - 1) * self.dt


def joint_move(
    model: RobotModel, q0: ArrayLike, q1: ArrayLike, scale: float = 1.0, dt: float = DT, name: str = "joint_move"
) -> Trajectory:
    """Straight in joint space from rest at q0 (6,) to rest at q1 (6,) in [rad].

    Raises:
        ValueError: a start or end that is not finite, or outside the joint limits.
    """
    q0, q1 = np.asarray(q0, dtype=np.float64), np.asarray(q1, dtype=np.float64)
    if not model.within_limits(np.stack([q0, q1])).all():
        raise ValueError(f"{name}: start or end outside the joint limits of {model.name}")
    return Trajectory(name, *move_motion(model, q0, q1).sampled(dt, scale), dt)


def joint_path(
    model: RobotModel, waypoints: ArrayLike, scale: float = 1.0, dt: float = DT, name: str = "joint_path"
) -> Trajectory:
    """Straight in joint space from waypoint to waypoint (n >= 2, 6) in [rad], at rest at each."""
    q = np.asarray(waypoints, dtype=np.float64)
    moves = [joint_move(model, a, b, scale, dt, name) for a, b in pairwise(q)]
    return concatenate(name, moves)


def tool_line(
    model: RobotModel, T0: Array, T1: Array, q0: Array, sigma_min: float = SIGMA_MIN, samples: int = LINE_SAMPLES
) -> JointPath | Refusal:
    """The joint path of a straight flange line from T0 to T1 (4, 4) in the branch of q0 (6,), or why there is none.

    The rotation turns about one axis at a constant rate (slerp). The tool's own line is straight only where both ends
    have the same rotation, as in every line of a pick.
    """
    s = np.linspace(0.0, 1.0, samples)
    rotations = np.broadcast_to(T0[:3, :3], (samples, 3, 3))
    if not np.array_equal(T0[:3, :3], T1[:3, :3]):
        turn = Slerp([0.0, 1.0], Rotation.from_matrix(np.stack([T0[:3, :3], T1[:3, :3]])))
        rotations = turn(s).as_matrix()
    Ts = make_transform(rotations, T0[:3, 3] + s[:, None] * (T1[:3, 3] - T0[:3, 3]))
    slot = int(branch(model, q0))
    found = inverse(model, Ts, q0)
    if not found.exists[:, slot].all():
        return Refusal(Cause.OUT_OF_REACH)
    if (found.sigma[:, slot] < sigma_min).any():
        return Refusal(Cause.SINGULARITY)
    q = np.unwrap(np.concatenate([q0[None], found.q[:, slot]]), axis=0)[1:]
    if np.abs(q[0] - q0).max() > 1e-6:
        raise ValueError("q0 is not a solution of T0")
    outside = ((q < model.lower) | (q > model.upper)).any(axis=0)
    if outside.any():
        return Refusal(Cause.JOINT_LIMIT, joint=int(np.argmax(outside)) + 1)
    if np.abs(np.diff(q, axis=0)).max() > MAX_LINE_STEP:
        return Refusal(Cause.SINGULARITY)
    q[0] = q0
    return JointPath(CubicSpline(s, q, axis=0))


def linear_move(
    model: RobotModel,
    T0: Array,
    T1: Array,
    q0: Array,
    scale: float = 1.0,
    dt: float = DT,
    name: str = "linear_move",
) -> Trajectory | None:
    """Straight flange line from rest at T0 (4, 4) to rest at T1; None where `tool_line` finds none."""
    path = tool_line(model, T0, T1, q0)
    return None if isinstance(path, Refusal) else follow(model, path, scale, dt, name)


def follow(model: RobotModel, path: JointPath, scale: float = 1.0, dt: float = DT, name: str = "follow") -> Trajectory:
    """Trajectory along a joint path from rest to rest."""
    return Trajectory(name, *path_motion(model, path).sampled(dt, scale), dt)


def move_motion(model: RobotModel, q0: Array, q1: Array) -> Motion:
    """The motion of `joint_move`."""
    return Motion((joint_segment(model, q0, q1),), q1)


def path_motion(model: RobotModel, path: JointPath) -> Motion:
    """The motion of `follow`."""
    segment = path_segment(model, path)
    if segment is None:
        raise ValueError("no motion profile along the path")
    return Motion((segment,), path.end)


def concatenate(name: str, trajectories: Sequence[Trajectory]) -> Trajectory:
    """Concatenate trajectories; each starts at rest where the one before ended at rest."""
    for a, b in pairwise(trajectories):
        gap = np.abs(a.q[-1] - b.q[0]).max()
        speed = max(np.abs(a.qd[-1]).max(), np.abs(b.qd[0]).max())
        if a.dt != b.dt or gap > 1e-6 or speed > 1e-6:
            raise ValueError(f"{b.name} does not start where {a.name} ends, at rest and at the same rate")
    first, rest = trajectories[0], trajectories[1:]
    q = np.concatenate([first.q, *(t.q[1:] for t in rest)])
    qd = np.concatenate([first.qd, *(t.qd[1:] for t in rest)])
    return Trajectory(name, q, qd, first.dt)


def tool_acceleration(model: RobotModel, motion: Motion, T_flange_tool: Array, step: float = 0.010) -> float:
    """Largest acceleration of the TCP at full speed in [m/s2], by second differences `step` [s] apart."""
    points = (flange_poses(model, motion.sampled(step)[0]) @ T_flange_tool)[:-1, :3, 3]
    if len(points) < 3:
        return 0.0
    return float(np.linalg.norm(np.diff(points, 2, axis=0), axis=1).max() / step**2)


def gentle_scale(model: RobotModel, motion: Motion, T_flange_tool: Array, limit: float) -> float:
    """The scale in (0, 1] at which the TCP's acceleration stays below `limit` [m/s2]."""
    peak = tool_acceleration(model, motion, T_flange_tool)
    return 1.0 if peak <= limit else 0.98 * float(np.sqrt(limit / peak))
