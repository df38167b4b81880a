"""Start and end of a motion: a stop, the straight tool line next to it, and the limits of speed."""

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
    """Limits of speed and load of a motion.

    Attributes:
        speed: share (0, 1] of the arm's speed. dt: between samples in [s].
        T_flange_tool: (4, 4). acceleration: limit of the TCP in [m/s2], None for no limit.
        load: on the flange, for the torques; None for no check.
    """

    speed: float
    dt: float
    T_flange_tool: Array
    acceleration: float | None = None
    load: Load | None = None


def first_beyond(robot: RobotModel, q: Array, T_flange_tool: Array, distance: float) -> int:
    """Index of the first of q (n, 6) whose TCP is `distance` [m] from the first one, or of the farthest."""
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
        """The line in joint space, or the reason why there is none."""
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
        line: away from it; None where any direction is allowed.
        mode: of the collision checks along the line.
        straight: length [m] of the part of the line that must be straight; None for all of it.
        narrowing: time in [s] after the line of a start in which the jaws move from the waiting to the approach
            opening.
    """

    q: Array
    line: Line | None = None
    mode: Mode = "transit"
    straight: float | None = None
    narrowing: float = 0.0

    @cached_property
    def usable(self) -> Line | Refusal | None:
        """The part of the line that the arm can follow, at least `straight`; None where it is shorter."""
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
