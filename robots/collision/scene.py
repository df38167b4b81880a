"""Collision checks of arm, tool and held part against obstacles, the scanned pile, and the arm itself.

Geometry is exact for boxes, cylinders and convex hulls (Coal) behind a broad phase (Pinocchio's dynamic AABB tree). The
world frame is the robot's base frame. Fixed bodies (the arm's base among them) are never checked against each other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from pickproof.cell.frames import Array, apply
from pickproof.cell.geometry.bin import Box
from pickproof.robots.collision.checker import Checker, Ground, Mode
from pickproof.robots.collision.held_part import HeldPart
from pickproof.robots.failure import Contact
from pickproof.robots.kinematics.chain import travelled
from pickproof.robots.kinematics.inverse import arm_of
from pickproof.robots.kinematics.model import RobotModel

MARGINS = (0.008, 0.002)  # [m] margin at the first checks of a path, which then cover a longer piece of it
PATH_STEP = 0.001  # [m] of travel between checks where the distance is smaller than that margin
THICK = 0.25  # share of the upper arm's length: radius of links around the wrist centre; twice that around the elbow
MAX_KNOT_STEP = 0.05  # [rad] step between joint vectors for which the travel of all points is measured


@dataclass(frozen=True, eq=False)
class HeightField:
    """Solid ground below scanned heights.

    Attributes:
        heights: (ny, nx) world z in [m] at nodes x = x0 + column * step, y = y0 + row * step; finite.
    """

    heights: Array
    x0: float
    y0: float
    step: float

    def __post_init__(self) -> None:
        if self.heights.ndim != 2 or min(self.heights.shape) < 2 or not np.isfinite(self.heights).all():
            raise ValueError("heights must be finite and at least 2 x 2; fill unseen cells first")


class CollisionScene:
    """Obstacles of the arm, and the collision checks against them.

    Args:
        robot: the arm.
        tool_boxes: boxes of the gripper; their `T_world_box` is read as T_flange_box. Parts whose name starts with
            `finger` may enter the height field in mode `contact`.
        obstacles: boxes in the world; parts of the cell that never move.
        heightfield: the scanned pile above the bin, or None.
        start_boxes: boxes of the gripper until it has left its waiting pose; None for `tool_boxes`.
        placed: ground with the workpieces placed so far; `placed_before`: without the last released one.
        kept_clear: names of the obstacles to which a blended motion keeps CLEARANCE_MARGIN, `pile` for the scanned
            pile; arm and jaws deviate from their commands, and a scan has gaps.

    Mode `transit` checks everything. Mode `leave` does too, with the gripper as it waits. Mode `depart` is for the line
    away from the waiting pose; it ignores the workpiece just released (and, after `stands_among_placed`, all placed
    ones). Mode `contact` is for the last line to a grasp and the first line after it; it ignores fingers and held part
    against the height field, and reduces the held part by its pose tolerance; walls and table are checked.
    """

    def __init__(
        self,
        robot: RobotModel,
        tool_boxes: Sequence[Box],
        obstacles: Sequence[Box],
        heightfield: HeightField | None = None,
        start_boxes: Sequence[Box] | None = None,
        placed: HeightField | None = None,
        placed_before: HeightField | None = None,
        kept_clear: Sequence[str] = (),
    ) -> None:
        self.robot, self.kept_clear, self._kept = robot, frozenset(kept_clear), frozenset(kept_clear)
        self.tool_boxes, self.obstacles, self.heightfield = tuple(tool_boxes), tuple(obstacles), heightfield
        self.start_boxes = self.tool_boxes if start_boxes is None else tuple(start_boxes)
        self._placed, self._placed_before = (None if f is None else _ground(f) for f in (placed, placed_before))
        self._ground = self._ground_held = None if heightfield is None else _ground(heightfield)
        self._held: HeldPart | None = None
        self._tolerance = 0.0
        self._checkers: dict[str, Checker] = {}
        self._corners_of: tuple[HeldPart | None, Array] | None = None

    def hold(self, held: HeldPart, tolerance: float = 0.005, without: HeightField | None = None) -> None:
        """Attach a part, in the flange frame; in mode `contact` it is reduced by `tolerance` [m] on all sides.

        A part at rest touches floor, walls and neighbours; with the tolerance, an error of its estimated pose is no
        collision.

        Args:
            without: the pile after the part has left it; None for the scanned pile, which contains the part.
        """
        self._ground_held = self._ground if without is None else _ground(without)
        known = self._checkers.get("held")
        if known is not None and not known.takes(held, tolerance):
            del self._checkers["held"]
        self._held, self._tolerance = held, tolerance

    @property
    def held(self) -> HeldPart | None:
        """The held part, in the flange frame."""
        return self._held

    def release(self) -> None:
        """Release the held part."""
        self._held = None

    @contextmanager
    def empty_handed(self) -> Iterator[None]:
        """No held part inside this context."""
        held, self._held = self._held, None
        try:
            yield
        finally:
            self._held = held

    def stands_among_placed(self) -> None:
        """From now on mode `depart` ignores all placed workpieces: the gripper is between them, or one fell against
        it.
        """
        if self._placed_before is not None:
            self._placed_before = None
            self._checkers.pop("depart", None)

    def keep_clear(self, *ends: Array) -> None:
        """From now on keep the clearance margin in blended motions, except to obstacles closer than it at start or end
        (6,) [rad].
        """
        self._kept = self.kept_clear
        if not all(self.free(q) for q in ends):
            self._kept = frozenset(name for name in self.kept_clear if self._respected(name, ends))

    def _respected(self, name: str, ends: Sequence[Array]) -> bool:
        free = []
        for self._kept in (frozenset(), frozenset({name})):
            free.append([self.free(q) for q in ends])
        return free[0] == free[1]

    def free(self, q: Array, mode: Mode = "transit") -> bool:
        """Whether q (6,) in [rad] is free of collisions."""
        return self._checker(mode).free(q)

    def first_contact(self, q: Array, mode: Mode = "transit") -> Contact | None:
        """Names of one pair that touches at q (6,) in [rad]: link, tool box or `held`, then the other body."""
        return self._checker(mode).contact(q)

    def free_path(self, qs: Array, mode: Mode = "transit") -> bool:
        """Whether the polyline qs (n, 6) in [rad] is free of collisions: no point travels over 1 mm between checks."""
        return self._blocked(qs, mode) is None

    def path_contact(self, qs: Array, mode: Mode = "transit") -> Contact | None:
        """Like `free_path`, but returns a pair that touches on the path, or None."""
        q = self._blocked(qs, mode)
        return None if q is None else self._checker(mode).contact(q)

    def blocked_at(self, qs: Array, mode: Mode = "transit") -> float | None:
        """Like `free_path`, but returns the index of qs (n, 6) near a collision, or None."""
        q = self._blocked(qs, mode)
        return None if q is None else float(np.argmin(np.abs(np.asarray(qs) - q).max(axis=1)))

    def _blocked(self, qs: Array, mode: Mode) -> Array | None:
        """A joint vector (6,) on the polyline with a collision, or None.

        If all pairs are a margin apart at one joint vector, the path is free as far as no point travels more than this
        margin. So a path is checked in cells of twice a margin; cells with a smaller distance are divided, down to
        PATH_STEP.
        """
        checker, (knots, travel) = self._checker(mode), self._travel(qs)
        cells = np.array([[0.0, travel[-1]]])
        for margin in MARGINS:
            cells = _split(cells, 2 * margin)
            close = [
                k for k, q in enumerate(_at_length(travel, knots, cells.mean(axis=1))) if not checker.free(q, margin)
            ]
            cells = cells[close]
            middles = _at_length(travel, knots, cells.mean(axis=1))
            hit = next((middles[k] for k in _coarse_to_fine(len(close)) if not checker.free(middles[k])), None)
            if hit is not None or not close:
                return hit
        samples = _at_length(travel, knots, _split(cells, PATH_STEP).mean(axis=1))
        return next((samples[k] for k in _coarse_to_fine(len(samples)) if not checker.free(samples[k])), None)

    def _travel(self, qs: Array) -> tuple[Array, Array]:
        """Joint vectors (m, 6) on the polyline, and how far (m,) any point of arm, tool or part has travelled at most.

        A body between two measured points travels no further than the one that travels most. The 5 % cover arcs between
        knots.
        """
        qs = np.asarray(qs, dtype=np.float64).reshape(-1, 6)
        steps = np.ceil(np.abs(np.diff(qs, axis=0)).max(axis=1, initial=0.0) / MAX_KNOT_STEP).clip(1).astype(int)
        at = np.concatenate([[0.0], *(k + np.arange(1, n + 1) / n for k, n in enumerate(steps))])
        knots = np.stack([np.interp(at, np.arange(len(qs)), qs[:, j]) for j in range(6)], axis=1)
        far = travelled(arm_of(self.robot), knots, self.corners, self._thick)
        return knots, 1.05 * far

    @property
    def _thick(self) -> float:
        return THICK * self.robot.opw.c2

    @property
    def corners(self) -> Array:
        """Corners (n, 3) of tool and held part, and the flange, in the flange frame."""
        if self._corners_of is None or self._corners_of[0] is not self._held:
            held = [] if self._held is None else [self._held.corners]
            boxes = (_corners(b) for b in (*self.tool_boxes, *self.start_boxes))
            self._corners_of = self._held, np.concatenate([np.zeros((1, 3)), *boxes, *held])
        return self._corners_of[1]

    def _checker(self, mode: Mode) -> Checker:
        state = "held" if self._held else "empty"
        if mode in ("depart", "leave"):
            state, mode = mode, "transit"
        if state not in self._checkers:
            boxes = self.start_boxes if state in ("depart", "leave") else self.tool_boxes
            placed = self._placed_before if state == "depart" else self._placed
            pile = self._ground_held if self._held else self._ground
            self._checkers[state] = Checker(
                self.robot, self.obstacles, boxes, pile, placed, self._held, self._tolerance, self.kept_clear
            )
        if state == "held":
            self._checkers[state].stand_over(self._ground_held)
        self._checkers[state].turn_to(mode, self._kept)
        return self._checkers[state]


def _ground(field: HeightField) -> Ground:
    """Coal's height field is centred at its origin and its row 0 is at +y; ours starts at y0."""
    ny, nx = field.heights.shape
    dx, dy = (nx - 1) * field.step, (ny - 1) * field.step
    z = np.ascontiguousarray(field.heights[::-1], dtype=np.float64)
    shape = coal.HeightFieldAABB(dx, dy, z, float(z.min()) - 0.02)
    return shape, pin.SE3(np.eye(3), np.array([field.x0 + dx / 2, field.y0 + dy / 2, 0.0]))


def _corners(box: Box) -> Array:
    signs = np.array(list(np.ndindex(2, 2, 2)), dtype=np.float64) - 0.5
    return apply(box.T_world_box, signs * np.array(box.size))


def _split(cells: Array, length: float) -> Array:
    """Intervals (n, 2), each cut into equal ones of at most `length`."""
    counts = np.ceil((cells[:, 1] - cells[:, 0]) / length - 1e-9).clip(1).astype(int)
    which = np.repeat(np.arange(len(cells)), counts)
    k = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    step = ((cells[:, 1] - cells[:, 0]) / counts)[which]
    start = cells[which, 0] + k * step
    return np.stack([start, start + step], axis=1)


def _at_length(s: Array, qs: Array, at: Array) -> Array:
    """Points of the polyline qs (n, 6) with lengths s (n,) at lengths `at`."""
    keep = np.concatenate([[True], np.diff(s) > 0])
    return np.stack([np.interp(at, s[keep], qs[keep, j]) for j in range(6)], axis=1)


def _coarse_to_fine(n: int) -> Iterator[int]:
    """All of range(n), ends first and then by bisection, so that a collision is found early."""
    if n == 0:
        return
    yield n - 1
    stride = 1 << max(n - 1, 1).bit_length()
    seen_every = 0
    while stride:
        for i in range(0, n - 1, stride):
            if not seen_every or i % seen_every:
                yield i
        seen_every, stride = stride, stride // 2
