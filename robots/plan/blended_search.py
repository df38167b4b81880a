"""Search of the fastest collision-free blended motion between two stops: the roundest first, then sharper and higher
ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from heapq import heappop, heappush

import numpy as np

from pickproof.cell.frames import Array
from pickproof.robots.collision.checker import Mode
from pickproof.robots.collision.scene import CollisionScene
from pickproof.robots.failure import Cause, Refusal
from pickproof.robots.kinematics.chain import kept_to_line
from pickproof.robots.kinematics.inverse import arm_of
from pickproof.robots.motion.blended_motion import Between, BlendedMotion, End, Form
from pickproof.robots.motion.dynamics import bearable
from pickproof.robots.motion.stop import Line, Pace, Stop, first_beyond
from pickproof.robots.motion.timing import JointPath, Motion
from pickproof.robots.motion.trajectory import Trajectory

WAITS = (0.0, 0.05, 0.1, 0.2, 0.35, 0.6, 1.0)  # waits of the turn at each end, see `robots.motion.blended_motion.Form`
RAISED = (0.0, 0.03, 0.06, 0.1, 0.15)  # [m] heights by which the middle of the path is raised
STRIDE = 2
CORRIDOR = 0.002  # [m] distance of a corner of gripper or part from a line up to which it counts as on it
CHECK_STEP = 0.008  # [s] between joint vectors in collision checks of a motion
GLANCES = 16  # single configurations that are checked before the whole motion

_Node = tuple[int, int, int]  # indices of both waits and of the height


@dataclass(order=True)
class _Candidate:
    """A blended motion in a queue: the fastest first, among equals the one found first."""

    seconds: float
    number: int
    node: _Node = field(compare=False)
    blend: BlendedMotion = field(compare=False)


def search_blended(
    scene: CollisionScene, start: Stop, end: Stop, pace: Pace, name: str, forms: int
) -> Trajectory | Refusal:
    """Motion along the line away from `start`, freely, and along the line to `end`, without a stop.

    A refusal is `early` where every tried form had a collision in its first half.

    Forms are tried in the order of their duration. After a collision, the turn waits longer at the nearer end, or the
    path is raised, by STRIDE entries of the lists above. From the first free form, skipped ones are tried backwards.
    The result is nearly that of trying all, in a third of the time.
    """
    ends = [_end(stop) for stop in (start, end)]
    if ends[0] is None or ends[1] is None:
        return Refusal(Cause.COLLISION)
    early = True
    between = Between(scene.robot, ends[0], ends[1], pace.T_flange_tool, scene.corners, pace.acceleration)
    raised = [np.zeros(6), *between.raised(np.array(RAISED[1:]))]
    waiting: list[_Candidate] = []
    seen: set[_Node] = set()

    def candidate(node: _Node) -> _Candidate | None:
        k0, k1, height = node
        if node in seen or min(node) < 0 or max(k0, k1) >= len(WAITS) or height >= len(RAISED):
            return None
        seen.add(node)
        b = raised[height]
        if b is None:
            return None
        seconds, blend = between.quickest(Form((WAITS[k0], WAITS[k1]), b), pace.speed)
        return _Candidate(seconds, len(seen), node, blend)

    def add(node: _Node) -> None:
        found = candidate(node)
        if found is not None:
            heappush(waiting, found)

    def hit_by(tried: _Candidate) -> float | None:
        return _hit(scene, Motion((tried.blend,), end.q), start, end, pace.T_flange_tool)

    add((0, 0, 0))
    while waiting and len(seen) < forms:
        best = heappop(waiting)
        hit = hit_by(best)
        k0, k1, height = best.node
        if hit is not None:
            early &= hit < 0.5
            add((k0 + STRIDE, k1, height) if hit < 0.5 else (k0, k1 + STRIDE, height))
            add((k0, k1, height + STRIDE))
            continue
        for axis in range(3):
            less = candidate(tuple(k - (i == axis) for i, k in enumerate(best.node)))  # type: ignore[arg-type]
            if less is not None and less.seconds < best.seconds and hit_by(less) is None:
                best = less
        motion = Motion((best.blend,), end.q)
        scale = bearable(scene.robot, motion, between.scale(best.blend, pace.speed), pace.load)
        if isinstance(scale, Refusal):
            return Refusal(Cause.COLLISION)
        return Trajectory(name, *motion.sampled(pace.dt, scale), pace.dt)
    return Refusal(Cause.COLLISION, early=early)


def _end(stop: Stop) -> End | None:
    line = stop.usable
    if line is None:
        return End(stop.q)
    if not isinstance(line, Line) or not isinstance(line.path, JointPath):
        return None
    return End(stop.q, line.path, line.length, min(line.length, stop.straight or line.length))


def _hit(scene: CollisionScene, motion: Motion, start: Stop, end: Stop, T_flange_tool: Array) -> float | None:
    """Share [0, 1] of its time at which a motion collides or exceeds the joint limits; None where it is free.

    Each section is checked in its mode; a few configurations are checked before the whole.
    """
    q = motion.sampled(CHECK_STEP)[0]
    inside = scene.robot.within_limits(q)
    if not inside.all():
        return float(np.argmin(inside)) / (len(q) - 1)
    first = _on_line(scene, q, start)
    last = len(q) - 1 - _on_line(scene, q[::-1], end)
    if first >= last:
        first, last = 0, len(q) - 1
    left = narrow = first
    if start.mode == "depart" and start.line is not None:
        left = min(max(first, first_beyond(scene.robot, q, T_flange_tool, start.line.length)), last)
        narrow = min(left + int(np.ceil(start.narrowing / CHECK_STEP)), last)
    for k in np.linspace(left, last, GLANCES).astype(int)[1:-1]:
        if not scene.free(q[k]):
            return float(k) / (len(q) - 1)
    stretches: tuple[tuple[int, int, Mode], ...] = (
        (left, last, "transit"),
        (first, narrow, "leave"),
        (0, first, start.mode),
        (last, len(q) - 1, end.mode),
    )
    for a, b, mode in stretches:
        if b > a or mode in ("contact", "depart"):
            where = scene.blocked_at(q[a : b + 1], mode)
            if where is not None:
                return (a + where) / (len(q) - 1)
    return None


def _on_line(scene: CollisionScene, q: Array, stop: Stop) -> int:
    """Index of the last of q (n, 6) up to which gripper and part stay in the corridor of the stop's whole line."""
    if stop.line is None or stop.mode == "transit":
        return 0
    length = stop.line.length
    way = stop.line.way / length
    arm = arm_of(scene.robot)
    return int(kept_to_line(arm, np.ascontiguousarray(q), scene.corners, way, length, CORRIDOR))
