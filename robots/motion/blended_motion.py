"""Motions without intermediate stops: away along a straight tool line, free motion, then along another line.

Three motion profiles are added up: along the line q1 away from the start, along the line q2 to the end, and the turn
of all joints from the far end of the one to the far end of the other,
    q(t) = q1(s1(t)) + d u + 4 b u (1 - u) + q2(s2(T - t)) - q2(1)   with d = q2(1) - q1(1), u = u(t - wait),
where b raises the middle of the path over obstacles. Each profile goes from rest to rest, so the sum is smooth for any
wait. The turn starts while the tool is still on the line, after its straight part. The sum is then scaled in time to
the largest speed that keeps all limits.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import product

import numpy as np

from pickproof.cell.frames import Array, apply
from pickproof.robots.kinematics.inverse import SIGMA_MIN, arm_of, branch, flange_poses, inverse
from pickproof.robots.kinematics.model import RobotModel
from pickproof.robots.motion.blended_kernels import fastest, quickest, sampled, timing
from pickproof.robots.motion.timing import JointPath

SHAPES = ((1.0, 1.0), (1.0, 0.8), (0.5, 0.7))  # speed and acceleration of the turn, as shares of the joint limits
HARD = (1.0, 0.75)  # jerk along the lines, as a share of the joint limits
SHARE = 0.35  # share of a line over which the tool accelerates
OFF_LINE = 0.001  # [m] allowed deviation of a corner of gripper or part from the straight part
MARGIN, TOOL_MARGIN = 0.99, 0.98  # share of the joint limits and of the limit of the tool's acceleration
SAMPLES = 56  # number of times at which limits are checked during the search
FINE = 400  # the same for the chosen motion
STARTS = np.array([(*shape, 1.0, hard, SHARE, hard, SHARE) for shape, hard in product(SHAPES, HARD)])
Way = tuple[Array, Array, Array, Array, Array, Array, Array]
Machine = tuple[Array, Array, Array, float]
_NO_LINE = (np.zeros(1), np.zeros((4, 0, 6)))


@dataclass(frozen=True, eq=False)
class End:
    """Where a motion starts or ends at rest.

    Attributes:
        q: (6,) at rest in [rad].
        path: joint path of the line away from it; None where there is no line.
        length: of the line in [m]; straight: length of its part that must be straight.
    """

    q: Array
    path: JointPath | None = None
    length: float = 0.0
    straight: float = 0.0

    @cached_property
    def far(self) -> Array:
        """(6,) where the line ends."""
        return self.q if self.path is None else self.path.end

    @property
    def spline(self) -> tuple[Array, Array]:
        """Knots and coefficients of the line, in the form of `robots.motion.blended_kernels`."""
        return _NO_LINE if self.path is None else (self.path.spline.x, np.ascontiguousarray(self.path.spline.c))


@dataclass(frozen=True, eq=False)
class BlendedMotion:
    """One motion, a segment of `robots.motion.timing.Motion`.

    Attributes:
        tables, way: see `robots.motion.blended_kernels`.
        wait: of the turn; duration: of the whole, in [s].
    """

    tables: Array
    way: Way
    wait: float
    duration: float

    def at(self, times: Array) -> tuple[Array, Array]:
        """Positions and velocities (n, 6) at times (n,) in [s]."""
        return sampled(np.asarray(times, np.float64), self.duration, self.wait, self.tables, self.way)


@dataclass(frozen=True)
class Form:
    """The shape of a blended motion.

    Attributes:
        waits: (first, last) waiting of the turn: 0 starts it right after the straight part of the line, 1 after the
            whole line, when the tool is at rest.
        raised: (6,) b, the joint offset that raises the middle of the path.
    """

    waits: tuple[float, float]
    raised: Array


@dataclass(frozen=True, eq=False)
class Between:
    """The blended motions between two ends.

    Attributes:
        T_flange_tool: (4, 4). corners: (k, 3) of gripper and part in the flange frame.
        limit: largest acceleration of the tool in [m/s2], None for no limit.
    """

    model: RobotModel
    start: End
    end: End
    T_flange_tool: Array
    corners: Array
    limit: float | None = None
    _known: dict[bytes, tuple[Way, Array, Array]] = field(default_factory=dict)

    def quickest(self, form: Form, speed: float) -> tuple[float, BlendedMotion]:
        """The fastest blended motion of a form, and its approximate time [s] at the share `speed` of the arm's
        speed.
        """
        (way, top, lines), machine, levels = self._over(form.raised), self._machine(speed), np.array(form.waits)
        factors, seconds = quickest(STARTS, top, lines, levels, OFF_LINE, SAMPLES, way, machine)
        tables, wait, total = timing(factors, top, lines, levels, OFF_LINE)
        return seconds / speed, BlendedMotion(tables, way, wait, total)

    def scale(self, blend: BlendedMotion, speed: float) -> float:
        """Largest time scale of a blended motion within the limits of joints and tool, relative to its profiles.

        Enough points are checked to include every phase.
        """
        limits = self._machine(speed)
        return speed * float(fastest(FINE, blend.duration, blend.wait, blend.tables, blend.way, limits, 0.0))

    def raised(self, heights: Array) -> list[Array | None]:
        """Joint offsets that raise the tool in the middle of the turn by each height (n,) in [m]; see `Form`.

        None where the arm cannot go there in its branch.
        """
        q = (self.start.far + self.end.far) / 2
        Ts = np.repeat(flange_poses(self.model, q[None]), len(heights), axis=0)
        Ts[:, 2, 3] += heights
        found, slot = inverse(self.model, Ts, q), int(branch(self.model, q))
        good = found.valid[:, slot] & (found.sigma[:, slot] > SIGMA_MIN)
        return [x - q if ok else None for x, ok in zip(found.q[:, slot], good, strict=True)]

    def _over(self, raised: Array) -> tuple[Way, Array, Array]:
        """Inputs way, top and lines of `robots.motion.blended_kernels` for blended motions with this offset."""
        key = raised.tobytes()
        if key not in self._known:
            way = (self.start.far, self.end.far, raised, *self.start.spline, *self.end.spline)
            self._known[key] = way, self._top(raised), self._lines(raised)
        return self._known[key]

    def _machine(self, speed: float) -> Machine:
        model = self.model
        limits = np.stack([model.velocity * MARGIN, model.acceleration * MARGIN**2, model.jerk * MARGIN**3])
        shake = np.inf if self.limit is None else self.limit * (TOOL_MARGIN / speed) ** 2
        return limits, arm_of(model), np.ascontiguousarray(self.T_flange_tool[:3, 3]), shake

    def _top(self, raised: Array) -> Array:
        """(3,) largest velocity, acceleration and jerk of the turn that the joints allow."""
        steepest = np.maximum(np.abs(self.end.far - self.start.far) + 4 * np.abs(raised), 1e-9)
        limits = (self.model.velocity, self.model.acceleration, self.model.jerk)
        return np.array([(m / steepest).min() for m in limits])

    def _lines(self, raised: Array) -> Array:
        """Limits (2, 4) of both lines, see `robots.motion.blended_kernels.timing`."""
        turn = self.end.far - self.start.far
        steepest = [self._line(end) for end in (self.start, self.end)]
        reach = [self._reach(end, turn + sign * 4.0 * raised) for end, sign in ((self.start, 1.0), (self.end, -1.0))]
        return np.array([(*line, r) for line, r in zip(steepest, reach, strict=True)])

    def _line(self, end: End) -> tuple[float, float, float]:
        """Largest acceleration and jerk along a line, and its straight share."""
        if end.path is None:
            return 0.0, 0.0, 0.0
        a, j = (float((m / end.path.peaks[0]).min()) for m in (self.model.acceleration, self.model.jerk))
        a = a if self.limit is None else min(a, self.limit / end.length)
        return a, j, end.straight / end.length

    def _reach(self, end: End, turn: Array) -> float:
        """Travel [m] of a corner per unit of u for a turn (6,) of the joints, at the end of the straight part."""
        if end.path is None:
            return 0.0
        q, small = end.path.spline(end.straight / end.length), 1e-4
        before, after = apply(flange_poses(self.model, np.stack([q, q + small * turn])), self.corners)
        return float(np.linalg.norm(after - before, axis=1).max()) / small + 1e-9
