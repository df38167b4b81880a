"""Where a motion starts and ends: a stop, the straight tool line that leads to it, and how fast the motion may be."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pickproof.cell.frames import Array
from pickproof.robots.collision.checker import Mode
from pickproof.robots.failure import Refusal
from pickproof.robots.kinematics.inverse import flange_poses
from pickproof.robots.kinematics.model import RobotModel
from pickproof.robots.motion.dynamics import Load
from pickproof.robots.motion.timing import JointPath
from pickproof.robots.motion.trajectory import tool_line

SAMPLE_STEP = 0.005  # [m] between the points at which a line's joint vectors are exact
LEAST_SAMPLES, MOST_SAMPLES = 9, 33


@dataclass(frozen=True, eq=False)
class Pace:
    """How fast a motion may be.

    Attributes:
        speed: in (0, 1] of the arm's. dt: between samples in [s].
        T_flange_tool: (4, 4). acceleration: of the TCP not to exceed in [m/s2], None for any.
        load: what hangs on the flange, for the torques; None for nothing.
    """

    speed: float
    dt: float
    T_flange_tool: Array
    acceleration: float | None = None
    load: Load | None = None


def first_beyond(robot: RobotModel, q: Array, T_flange_tool: Array, distance: float) -> int:
    """Index of the first of q (n, 6) whose TCP is `distance` [m] from where it began, or of the farthest of all."""
    points = (flange_poses(robot, q) @ T_flange_tool)[:, :3, 3]
    away = np.linalg.norm(points - points[0], axis=1)
    return int(np.argmax(away >= min(distance, away.max())))


@dataclass(frozen=True, eq=False)
class Line:
    """A straight tool line away from a stop at flange pose T (4, 4) and joint vector q (6,), by `way` (3,) [m]."""

    robot: RobotModel
    T: Array
    q: Array
    way: Array

    @cached_property
    def length(self) -> float:
        """In [m]."""
        return float(np.linalg.norm(self.way))

    @cached_property
    def path(self) -> JointPath | Refusal:
        """In joint space, or why there is none."""
        T1 = self.T.copy()
        T1[:3, 3] += self.way
        samples = int(np.clip(np.ceil(self.length / SAMPLE_STEP) + 1, LEAST_SAMPLES, MOST_SAMPLES))
        return tool_line(self.robot, self.T, T1, self.q, samples=samples)

    def first(self, length: float) -> Line:
        """Its beginning."""
        return self if length >= self.length else replace(self, way=self.way * (length / self.length))


@dataclass(frozen=True, eq=False)
class Stop:
    """Where a motion starts or ends at rest.

    Attributes:
        q: (6,) in [rad].
        line: away from it; None where the arm may move as it likes.
        mode: of the collision checks along the line.
        straight: how much of the line is kept straight where that is enough, in [m]; None for all of it.
        narrowing: time in [s] after the line of a start that the jaws take from how they waited to how they grip.
    """

    q: Array
    line: Line | None = None
    mode: Mode = "transit"
    straight: float | None = None
    narrowing: float = 0.0

    @cached_property
    def usable(self) -> Line | Refusal | None:
        """As much of the line as the arm can follow, `straight` at least; None where there is none."""
        if self.line is None:
            return None
        least = min(self.straight or self.line.length, self.line.length)
        for share in (1.0, 0.85, 0.7, 0.55, 0.4, 0.2, 0.0):
            line = self.line.first(max(share * self.line.length, least))
            if isinstance(line.path, JointPath):
                return line
        assert isinstance(line.path, Refusal)
        return line.path

    @property
    def air(self) -> Array:
        """Joint vector (6,) at the free end of the line, as far as the arm can follow it."""
        line = self.usable
        return line.path.end if isinstance(line, Line) and isinstance(line.path, JointPath) else self.q
