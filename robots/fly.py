"""The quickest flight between two stops that touches nothing: the roundest first, then sharper and higher ones."""

from __future__ import annotations

from dataclasses import dataclass, field
from heapq import heappop, heappush

import numpy as np

from cell.frames import Array, apply
from robots.collision import CollisionScene, Mode
from robots.dynamics import bearable
from robots.failure import Refusal
from robots.flight import Between, End, Flight, Form
from robots.inverse import flange_poses
from robots.stop import Line, Pace, Stop
from robots.timing import JointPath, Motion
from robots.trajectory import Trajectory

WAITS = (0.0, 0.1, 0.3, 0.6, 1.0)  # of the turn at either end, see `robots.flight.Form`
RAISED = (0.0, 0.06, 0.15)  # [m] by which the middle of the way is raised
CORRIDOR = 0.002  # [m] any corner of hand or part may leave a line and still count as on it
CHECK_STEP = 0.008  # [s] between the joint vectors that stand for a motion in collision checks
GLANCES = 16  # single configurations that are looked at before a whole motion is checked

_Node = tuple[int, int, int]  # indices of both waits and of the height


@dataclass(order=True)
class _Candidate:
    """A flight; the quickest comes first, of equals the one that was found first."""

    seconds: float
    number: int
    node: _Node = field(compare=False)
    flight: Flight = field(compare=False)


def fly(scene: CollisionScene, start: Stop, end: Stop, pace: Pace, name: str, forms: int) -> Trajectory | None:
    """Along the line away from `start`, through the air and along the line to `end` without a stop, or None.

    Forms are tried in the order of the time they take. Where one touches something, the turn waits longer at the end
    that is nearer, or the way is raised.
    """
    ends = [_end(stop) for stop in (start, end)]
    if ends[0] is None or ends[1] is None:
        return None
    between = Between(scene.robot, ends[0], ends[1], pace.T_flange_tool, scene.corners, pace.acceleration)
    raised = [np.zeros(6), *between.raised(np.array(RAISED[1:]))]
    waiting: list[_Candidate] = []
    seen: set[_Node] = set()

    def add(node: _Node) -> None:
        k0, k1, height = node
        if node in seen or max(k0, k1) >= len(WAITS) or height >= len(RAISED) or raised[height] is None:
            return
        seen.add(node)
        b = raised[height]
        assert b is not None
        seconds, flight = between.quickest(Form((WAITS[k0], WAITS[k1]), b), pace.speed)
        heappush(waiting, _Candidate(seconds, len(seen), node, flight))

    add((0, 0, 0))
    while waiting and len(seen) < forms:
        tried = heappop(waiting)
        motion = Motion((tried.flight,), end.q)
        hit = _hit(scene, motion, start, end)
        if hit is None:
            scale = bearable(scene.robot, motion, between.scale(tried.flight, pace.speed), pace.load)
            return None if isinstance(scale, Refusal) else Trajectory(name, *motion.sampled(pace.dt, scale), pace.dt)
        k0, k1, height = tried.node
        add((k0 + 1, k1, height) if hit < 0.5 else (k0, k1 + 1, height))
        add((k0, k1, height + 1))
    return None


def _end(stop: Stop) -> End | None:
    line = stop.usable
    if line is None:
        return End(stop.q)
    if not isinstance(line, Line) or not isinstance(line.path, JointPath):
        return None
    return End(stop.q, line.path, line.length, min(line.length, stop.straight or line.length))


def _hit(scene: CollisionScene, motion: Motion, start: Stop, end: Stop) -> float | None:
    """Where in [0, 1] of its time a motion touches something or leaves the joint limits; None where it is free.

    Each stretch is checked in its mode; a glance at a few configurations comes before the whole.
    """
    q = motion.sampled(CHECK_STEP)[0]
    inside = scene.robot.within_limits(q)
    if not inside.all():
        return float(np.argmin(inside)) / (len(q) - 1)
    first = _on_line(scene, q, start)
    last = len(q) - 1 - _on_line(scene, q[::-1], end)
    if first >= last:
        first, last = 0, len(q) - 1
    for k in np.linspace(first, last, GLANCES).astype(int)[1:-1]:
        if not scene.free(q[k]):
            return float(k) / (len(q) - 1)
    stretches: tuple[tuple[int, int, Mode], ...] = (
        (first, last, "transit"),
        (0, first, start.mode),
        (last, len(q) - 1, end.mode),
    )
    for a, b, mode in stretches:
        if b > a or mode != "transit":
            where = scene.blocked_at(q[a : b + 1], mode)
            if where is not None:
                return (a + where) / (len(q) - 1)
    return None


def _on_line(scene: CollisionScene, q: Array, stop: Stop) -> int:
    """Index of the last of q (n, 6) up to which hand and part stay in the corridor of the stop's whole line."""
    if stop.line is None or stop.mode == "transit":
        return 0
    length = stop.line.length
    way = stop.line.way / length
    moved = apply(flange_poses(scene.robot, q), scene.corners)
    moved = moved - moved[0]
    along = (moved @ way).mean(axis=1)
    off = np.linalg.norm(moved - along[:, None, None] * way, axis=-1).max(axis=1)
    outside = (off > CORRIDOR) | (along > length)
    return int(np.argmax(outside)) - 1 if outside.any() else len(q) - 1
