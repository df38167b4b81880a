"""Motions that stop only where the process must: off a straight tool line, through the air, onto another line.

Three laws run one over the other: along the line q1 away from the start, along the line q2 to the end, and the turn of
all joints from the far end of the one to the far end of the other,
    q(t) = q1(s1(t)) + d u + 4 b u (1 - u) + q2(s2(T - t)) - q2(1)   with d = q2(1) - q1(1), u = u(t - wait),
where b raises the middle of the way over what stands there. Each law goes from rest to rest, so the sum is smooth for
any wait: the joints that decide the time turn while others still lift, once the tool has left what must be straight.
What the sum does to the limits is measured, and the whole runs as fast as the tightest of them allows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from cell.frames import Array, apply
from robots.inverse import SIGMA_MIN, branch, flange_poses, inverse
from robots.law import Law, rise, s_curve
from robots.model import RobotModel
from robots.timing import JointPath

SHAPES = ((1.0, 1.0), (1.0, 0.8), (0.5, 0.7))  # speed and acceleration of the turn, of what joints allow
HARD = (1.0, 0.75)  # jerk along the lines, of what joints allow
SHARE = 0.35  # of a line, over which the tool speeds up
OFF_LINE = 0.0005  # [m] any corner of hand or part may leave what must be straight
MARGIN, TOOL_MARGIN = 0.99, 0.98  # of the joints' limits and of the tool's acceleration
SAMPLES = 36  # points in time at which limits are measured for a choice
FINE = 400  # and of what was chosen
TABLE = 33  # points at which a line's derivatives are kept
_SPEED, _ACCELERATION, _HARD = np.array([(*shape, hard) for shape, hard in product(SHAPES, HARD)]).T


@dataclass(frozen=True, eq=False)
class End:
    """Where a motion starts or ends at rest.

    Attributes:
        q: (6,) at rest in [rad].
        path: joint path of the line away from it; None where there is no line.
        length: of the line in [m]; straight: of it that must be kept straight.
    """

    q: Array
    path: JointPath | None = None
    length: float = 0.0
    straight: float = 0.0

    @property
    def far(self) -> Array:
        """(6,) where the line ends."""
        return self.q if self.path is None else self.path.end

    @cached_property
    def table(self) -> Array:
        """(TABLE, 4, 6): q(s) - q(1) and its first three derivatives at equal steps of s."""
        assert self.path is not None
        s = np.linspace(0.0, 1.0, TABLE)
        table = np.stack([self.path.spline(s, k) for k in range(4)], axis=1)
        table[:, 0] -= self.far
        return table


@dataclass(frozen=True, eq=False)
class Flight:
    """One motion, a segment of `robots.timing.Motion`.

    Attributes:
        first, turn, last: laws (n = 1) along the line away, of the turn, and along the line to the end, which runs
            backwards.
        raised: (6,) b.
        wait: of the turn; duration: of the whole, in [s].
    """

    start: End
    end: End
    first: Law
    turn: Law
    last: Law
    raised: Array
    wait: float
    duration: float

    def at(self, times: Array) -> tuple[Array, Array]:
        """Positions and velocities (n, 6) at times (n,) in [s]."""
        t = np.asarray(times)[None]
        u, ud = self.turn.at(t - self.wait)[:2, 0, :, None]
        d, b = self.end.far - self.start.far, 4.0 * self.raised
        q, qd = self.start.far + d * u + b * u * (1.0 - u), (d + b * (1.0 - 2.0 * u)) * ud
        for end, law, backwards in ((self.start, self.first, False), (self.end, self.last, True)):
            if end.path is not None:
                s, sd = law.at(self.duration - t if backwards else t)[:2, 0]
                q += end.path.spline(s) - end.far
                qd += end.path.spline(s, 1) * (-sd if backwards else sd)[:, None]
        return q, qd


@dataclass(frozen=True)
class Form:
    """How a flight rounds its corners.

    Attributes:
        waits: how long the turn waits at either end: from 0, as soon as the straight part of the line is behind, to 1,
            until the line has been left and the tool stands still.
        raised: (6,) b, by which the joints raise the middle of the way.
    """

    waits: tuple[float, float]
    raised: Array


@dataclass(frozen=True, eq=False)
class Between:
    """The flights between two ends.

    Attributes:
        T_flange_tool: (4, 4). corners: (k, 3) of hand and part in the flange frame.
        limit: largest acceleration of the tool in [m/s2], None for any.
    """

    model: RobotModel
    start: End
    end: End
    T_flange_tool: Array
    corners: Array
    limit: float | None = None

    def quickest(self, form: Form, speed: float) -> tuple[float, Flight]:
        """The quickest flight of a form, and about the seconds that it takes at `speed` of the arm's."""
        laws = [line and line[0] for line in self._lines]
        turn, waits, total = self._timing(form)
        seconds = total / (speed * self._fastest(form, laws, turn, waits[0], total, SAMPLES, speed))
        k = int(np.argmin(seconds))
        first, last = (turn.row(k) if law is None else law.row(k) for law in laws)
        flight = Flight(
            self.start, self.end, first, turn.row(k), last, form.raised, float(waits[0][k]), float(total[k])
        )
        return float(seconds[k]), flight

    def scale(self, flight: Flight, speed: float) -> float:
        """How many times as fast as its own laws a flight may run for the limits of joints and tool.

        They are measured at so many points that no phase is missed.
        """
        form, one = Form((0.0, 0.0), flight.raised), np.ones(1)
        laws = [None if e.path is None else law for e, law in ((self.start, flight.first), (self.end, flight.last))]
        total = one * flight.duration
        return speed * float(self._fastest(form, laws, flight.turn, one * flight.wait, total, FINE, speed)[0])

    def _fastest(
        self, form: Form, laws: list[Law | None], turn: Law, wait: Array, total: Array, samples: int, speed: float
    ) -> Array:
        """How many times as fast (n,) flights may run for the limits of joints, and of the tool at `speed`."""
        model, times = self.model, np.linspace(0.0, 1.0, samples) * total[:, None]
        q, *rates = self._measured(form, laws, turn, wait, total, times)
        limits = (model.velocity, model.acceleration, model.jerk)
        use = [np.abs(rate / limit).max(axis=(1, 2)) for rate, limit in zip(rates, limits, strict=True)]
        scale = MARGIN / np.max([use[0], np.sqrt(use[1]), np.cbrt(use[2])], axis=0)
        if self.limit is not None:
            points = (flange_poses(model, q.reshape(-1, 6)) @ self.T_flange_tool[:, 3])[:, :3].reshape(*q.shape[:2], 3)
            shaken = np.linalg.norm(points[:, 2:] - 2 * points[:, 1:-1] + points[:, :-2], axis=-1).max(axis=1)
            scale = np.minimum(scale, TOOL_MARGIN * np.sqrt(self.limit / (shaken + 1e-12)) * times[:, 1] / speed)
        return np.asarray(scale)

    def raised(self, heights: Array) -> list[Array | None]:
        """What raises the tool in the middle of the turn by each height (n,) in [m], as `Form` has it.

        None where the arm cannot go there in its branch.
        """
        q = (self.start.far + self.end.far) / 2
        Ts = np.repeat(flange_poses(self.model, q[None]), len(heights), axis=0)
        Ts[:, 2, 3] += heights
        found, slot = inverse(self.model, Ts, q), int(branch(self.model, q))
        good = found.valid[:, slot] & (found.sigma[:, slot] > SIGMA_MIN)
        return [x - q if ok else None for x, ok in zip(found.q[:, slot], good, strict=True)]

    def _timing(self, form: Form) -> tuple[Law, list[Array], Array]:
        """Laws of the turn, how long they wait at either end, and how long the whole takes."""
        steepest = np.maximum(np.abs(self.end.far - self.start.far) + 4 * np.abs(form.raised), 1e-9)
        limits = (self.model.velocity, self.model.acceleration, self.model.jerk)
        v, a, j = (float((m / steepest).min()) for m in limits)
        turn = s_curve(v * _SPEED, a * _ACCELERATION, np.full(len(_HARD), j))
        waits, total = [], np.zeros(len(_HARD))
        for line, level in zip(self._lines, form.waits, strict=True):
            if line is None:
                waits.append(total * 0.0)
                continue
            law, straight, reach = line
            least = (straight - np.cbrt(6 * OFF_LINE / (j * reach))).clip(0.0)
            waits.append(least + level * (law.duration - least).clip(0.0))
            total = np.maximum(total, law.duration)
        return turn, waits, np.maximum(total, waits[0] + turn.duration + waits[1])

    @cached_property
    def _lines(self) -> list[tuple[Law, Array, float] | None]:
        """For either end the laws along its line, when (n,) the straight part is behind, and how far the turn moves a
        corner there, in [m] for each unit of u."""
        return [None if end.path is None else self._line(end) for end in (self.start, self.end)]

    def _line(self, end: End) -> tuple[Law, Array, float]:
        steepest = np.maximum(np.abs(end.table[:, 1]).max(axis=0), 1e-9)
        a, j = (float((m / steepest).min()) for m in (self.model.acceleration, self.model.jerk))
        a = a if self.limit is None else min(a, self.limit / end.length)
        law = rise(a * _HARD**2, j * _HARD, np.full(len(_HARD), SHARE))
        assert end.path is not None
        q, small = end.path.spline(end.straight / end.length), 1e-4
        turned = q + small * (self.end.far - self.start.far)
        before, after = apply(flange_poses(self.model, np.stack([q, turned])), self.corners)
        reach = float(np.linalg.norm(after - before, axis=1).max()) / small
        return law, law.when(end.straight / end.length), reach + 1e-9

    def _measured(
        self, form: Form, laws: list[Law | None], turn: Law, wait: Array, total: Array, times: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Positions and their first three derivatives, each (n, m, 6), at times (n, m)."""
        u, v, a, j = turn.at(times - wait[:, None])[..., None]
        d, b = self.end.far - self.start.far, 4.0 * form.raised
        d1, d2 = d + b * (1.0 - 2.0 * u), -2.0 * b
        out = [self.start.far + d * u + b * u * (1.0 - u), d1 * v, d2 * v**2 + d1 * a, 3.0 * d2 * v * a + d1 * j]
        for end, law, sign in zip((self.start, self.end), laws, (1.0, -1.0), strict=True):
            if law is None:
                continue
            s = law.at(times if sign > 0 else total[:, None] - times)
            v, a, j = s[1:, ..., None]
            place = s[0] * (TABLE - 1)
            k = place.astype(int).clip(0, TABLE - 2)
            part = (place - k)[..., None, None]
            p = end.table[k] * (1.0 - part) + end.table[k + 1] * part
            p0, p1, p2, p3 = np.moveaxis(p, 2, 0)
            out[0] += p0
            out[1] += sign * p1 * v
            out[2] += p2 * v**2 + p1 * a
            out[3] += sign * (p3 * v**3 + 3.0 * p2 * v * a + p1 * j)
        return out[0], out[1], out[2], out[3]
