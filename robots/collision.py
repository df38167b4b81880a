"""Collision checks of arm, tool and held part against obstacles, the scanned pile, and the arm itself.

Geometry is exact for boxes and cylinders (Coal) behind a broad phase (Pinocchio's dynamic AABB tree). The world frame
is the robot's base frame. Fixed bodies (the arm's base among them) are never checked against each other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import coal
import numpy as np
import pinocchio as pin

from cell.bin import Box
from cell.frames import Array, apply
from robots.chain import travelled
from robots.failure import Contact
from robots.inverse import arm_of
from robots.model import RobotModel

Mode = Literal["transit", "contact", "depart", "leave"]
Ground = tuple[coal.CollisionGeometry, pin.SE3]

MARGINS = (0.008, 0.002)  # [m] kept from everything at the first checks of a path, which then say more
BERTH = 0.003  # [m] kept in flight from the obstacles that are to be given a berth
PATH_STEP = 0.001  # [m] of travel between checks where a path keeps less than that
THICK = 0.25  # of the upper arm's length: radius of the links around the wrist centre; twice that around the elbow
MAX_KNOT_STEP = 0.05  # [rad] between two joint vectors between which the travel of all points is measured


@dataclass(frozen=True, eq=False)
class HeightField:
    """Solid ground under scanned heights.

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
    """What the arm may hit.

    Args:
        robot: the arm.
        tool_boxes: boxes of the gripper; their `T_world_box` is read as T_flange_box. Parts whose name starts with
            `finger` may enter the height field in mode `contact`.
        obstacles: boxes in the world; parts of the cell that never move.
        heightfield: the scanned pile above the bin, or None.
        start_boxes: boxes of the gripper as it is until it has left where it waits; None for `tool_boxes`.
        placed: ground of what was placed elsewhere; `placed_before`: without what was let go last.
        berth: names of the obstacles that are kept BERTH away from in flight, `pile` for the scanned pile; arm and
            jaws are never quite where they are commanded, and a scan has gaps.

    Mode `transit` checks everything. So does mode `leave`, with the gripper as it waits, and mode `depart`, for the
    line away from where it waits, which ignores what it has just let go. Mode `contact`, for the last line to a grasp
    and the first line after it, ignores fingers and held part against the height field, and shrinks the held part by
    its pose tolerance; walls and table count.
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
        berth: Sequence[str] = (),
    ) -> None:
        self.robot, self.berth, self._kept = robot, frozenset(berth), frozenset(berth)
        self.tool_boxes, self.obstacles, self.heightfield = tuple(tool_boxes), tuple(obstacles), heightfield
        self.start_boxes = self.tool_boxes if start_boxes is None else tuple(start_boxes)
        self._placed, self._placed_before = (None if f is None else _ground(f) for f in (placed, placed_before))
        self._ground = self._ground_held = None if heightfield is None else _ground(heightfield)
        self._held: tuple[Box, ...] = ()
        self._tolerance = 0.0
        self._checkers: dict[str, _Checker] = {}
        self._corners_of: tuple[tuple[Box, ...] | None, Array] = (None, np.zeros((0, 3)))

    def hold(self, boxes_flange: Sequence[Box], tolerance: float = 0.005, without: HeightField | None = None) -> None:
        """Attach a part, given as boxes in the flange frame; in mode `contact` it is `tolerance` [m] smaller all round.

        A part at rest touches floor, walls and neighbours; the tolerance keeps an error of its estimated pose from
        reading as a collision.

        Args:
            without: the pile as it is once the part is out of it; None for the pile as scanned, the part in it.
        """
        held = tuple(boxes_flange)
        self._ground_held = self._ground if without is None else _ground(without)
        known = self._checkers.get("held")
        if known is not None and not known.takes(held, tolerance):
            del self._checkers["held"]
        self._held, self._tolerance = held, tolerance

    @property
    def held(self) -> tuple[Box, ...]:
        """The held part's boxes in the flange frame."""
        return self._held

    def release(self) -> None:
        """Let the held part go."""
        self._held = ()

    @contextmanager
    def empty_handed(self) -> Iterator[None]:
        """Without the held part for a while."""
        held, self._held = self._held, ()
        try:
            yield
        finally:
            self._held = held

    def give_berth(self, *ends: Array) -> None:
        """Keep the berth in flight from now on, but of what is nearer where the flight begins or ends, (6,) [rad]."""
        self._kept = self.berth
        if not all(self.free(q) for q in ends):
            self._kept = frozenset(name for name in self.berth if self._respected(name, ends))

    def _respected(self, name: str, ends: Sequence[Array]) -> bool:
        free = []
        for self._kept in (frozenset(), frozenset({name})):
            free.append([self.free(q) for q in ends])
        return free[0] == free[1]

    def free(self, q: Array, mode: Mode = "transit") -> bool:
        """Whether nothing touches at q (6,) in [rad]."""
        return self._checker(mode).free(q)

    def first_contact(self, q: Array, mode: Mode = "transit") -> Contact | None:
        """Names of one pair that touches at q (6,) in [rad]: link, tool box or `held`, then what it touches."""
        return self._checker(mode).contact(q)

    def free_path(self, qs: Array, mode: Mode = "transit") -> bool:
        """Whether the polyline qs (n, 6) in [rad] is free: nothing travels more than 1 mm between two checks."""
        return self._blocked(qs, mode) is None

    def path_contact(self, qs: Array, mode: Mode = "transit") -> Contact | None:
        """Like `free_path`, but names a pair that touches somewhere on the way, or None."""
        q = self._blocked(qs, mode)
        return None if q is None else self._checker(mode).contact(q)

    def blocked_at(self, qs: Array, mode: Mode = "transit") -> float | None:
        """Like `free_path`, but says near which index of qs (n, 6) something touches, or None."""
        q = self._blocked(qs, mode)
        return None if q is None else float(np.argmin(np.abs(np.asarray(qs) - q).max(axis=1)))

    def _blocked(self, qs: Array, mode: Mode) -> Array | None:
        """A joint vector (6,) on the polyline at which something touches, or None.

        Where everything keeps a margin at one joint vector, all others are free within which no point travels further
        than that. So a path is checked in cells twice as long as a margin, and only those that come closer in finer
        ones, down to PATH_STEP.
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

        A body between two points that are measured travels no further than the one of them that travels most. The 5 %
        are for arcs between knots.
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
        known, corners = self._corners_of
        if known is not self._held:
            boxes = (*self.tool_boxes, *self.start_boxes, *self._held)
            corners = np.concatenate([np.zeros((1, 3)), *(_corners(b) for b in boxes)])
            self._corners_of = self._held, corners
        return corners

    def _checker(self, mode: Mode) -> _Checker:
        state = "held" if self._held else "empty"
        if mode in ("depart", "leave"):
            state, mode = mode, "transit"
        if state not in self._checkers:
            boxes = self.start_boxes if state in ("depart", "leave") else self.tool_boxes
            placed = self._placed_before if state == "depart" else self._placed
            self._checkers[state] = _Checker(self, boxes, placed, self._held, self._tolerance)
        if state == "held":
            self._checkers[state].stand_over(self._ground_held)
        self._checkers[state].turn_to(mode, self._kept)
        return self._checkers[state]


class _Checker:
    """Pinocchio's geometry for one held part, with only the pairs that count."""

    def __init__(
        self,
        scene: CollisionScene,
        tool_boxes: tuple[Box, ...],
        placed: Ground | None,
        held: tuple[Box, ...],
        tolerance: float,
    ) -> None:
        self.model = scene.robot.kinematics
        self.data = self.model.createData()
        self.geometry = _arm_geometry(scene.robot).copy()
        frames = self.model.frames
        links = [(i, int(g.parentJoint)) for i, g in enumerate(self.geometry.geometryObjects)]
        self.names = [frames[g.parentFrame].name for g in self.geometry.geometryObjects]
        last = self.model.njoints - 1
        T_joint_flange = frames[scene.robot.flange].placement

        tool = [self._add(b.name, last, T_joint_flange, b) for b in tool_boxes]
        part = [self._add("held", last, T_joint_flange, b) for b in held]
        slim = [self._add("held", last, T_joint_flange, _smaller(b, tolerance)) for b in held]
        self._held, self._tolerance, self._parts, self._T_joint_flange = held, tolerance, (part, slim), T_joint_flange
        fixed = [self._add(b.name, 0, pin.SE3.Identity(), b) for b in scene.obstacles]
        self._ground = scene._ground_held if held else scene._ground
        ground = [] if self._ground is None else [self._add_shape("pile", 0, self._ground[1], self._ground[0])]
        self._pile = ground
        fixed += [] if placed is None else [self._add_shape("placed", 0, placed[1], placed[0])]
        fingers = {t for t in tool if self.names[t].startswith("finger")}

        arm = [a for a, i in links if i > 0]
        pairs = [(a, b) for a, i in links for b, j in links if j - i >= 2]
        pairs += [(t, a) for t in tool for a, i in links if i <= 4]
        pairs += [(p, a) for p in part + slim for a, i in links if i <= 5]
        pairs += [(m, f) for m in arm + tool + part + slim for f in fixed]
        pairs += [(m, g) for m in arm + tool + part for g in ground]
        pairs = sorted({(min(p), max(p)) for p in pairs})
        for pair in pairs:
            self.geometry.addCollisionPair(pin.CollisionPair(*pair))
        self.geometry_data = self.geometry.createData()
        slim_only = [k for k, p in enumerate(pairs) if set(p) & set(slim)]
        transit_only = [
            k for k, p in enumerate(pairs) if set(p) & set(part) or (set(p) & fingers and set(p) & set(ground))
        ]
        self._only: dict[Mode, list[int]] = {"transit": transit_only, "contact": slim_only}
        self._given_berth = {
            name: [k for k, p in enumerate(pairs) if name in (self.names[p[0]], self.names[p[1]])]
            for name in scene.berth
        }
        self._carried = {*tool, *part, *slim}
        self._mode: Mode | None = None
        self._margin, self._berth = 0.0, frozenset[str]()
        self._sort()

    def takes(self, held: tuple[Box, ...], tolerance: float) -> bool:
        """Hold boxes of the same sizes as before in another place; False where the sizes differ."""
        if tolerance != self._tolerance or [b.size for b in held] != [b.size for b in self._held]:
            return False
        if any(a is not b for a, b in zip(held, self._held, strict=True)):
            for indices in self._parts:
                for k, box in zip(indices, held, strict=True):
                    self.geometry.geometryObjects[k].placement = self._T_joint_flange * pin.SE3(
                        np.array(box.T_world_box)
                    )
            self._held = held
        return True

    def stand_over(self, ground: Ground | None) -> None:
        """Check against this ground in place of the one before."""
        if ground is not self._ground and ground is not None:
            for k in self._pile:
                self.geometry.geometryObjects[k].geometry, self.geometry.geometryObjects[k].placement = ground
            self._ground = ground
            self._sort()

    def _sort(self) -> None:
        self.broadphase = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(
            self.model, self.geometry, self.geometry_data
        )

    def turn_to(self, mode: Mode, kept: frozenset[str]) -> None:
        """Check the pairs of a mode, in `transit` with the berth of what is named in `kept`."""
        berth = kept if mode == "transit" else frozenset[str]()
        if berth != self._berth:
            self._berth, self._margin = berth, -1.0
        if mode != self._mode:
            for other, pairs in self._only.items():
                data = self.geometry_data
                switch = data.activateCollisionPair if other == mode else data.deactivateCollisionPair
                for k in pairs:
                    switch(k)
            self._mode = mode

    def free(self, q: Array, margin: float = 0.0) -> bool:
        """Whether everything keeps more than `margin` [m] at q (6,)."""
        if margin != self._margin:
            requests = self.geometry_data.collisionRequests
            for request in requests:
                request.security_margin = margin
            for name in self._berth:
                for k in self._given_berth[name]:
                    requests[k].security_margin = margin + BERTH
            self._margin = margin
        return not pin.computeCollisions(self.model, self.data, self.broadphase, q, True)

    def contact(self, q: Array) -> Contact | None:
        if self.free(q):
            return None
        pin.computeCollisions(self.model, self.data, self.geometry, self.geometry_data, q, True)
        active = self.geometry_data.activeCollisionPairs
        for k, (pair, result) in enumerate(
            zip(self.geometry.collisionPairs, self.geometry_data.collisionResults, strict=True)
        ):
            if active[k] and result.isCollision():
                first, second = pair.first, pair.second
                if second in self._carried:  # the tool or part is named before the link that it touches
                    first, second = second, first
                return self.names[first], self.names[second]
        raise AssertionError("a collision without a pair")

    def _add(self, name: str, joint: int, T_joint_parent: pin.SE3, box: Box) -> int:
        return self._add_shape(name, joint, T_joint_parent * pin.SE3(np.array(box.T_world_box)), coal.Box(*box.size))

    def _add_shape(self, name: str, joint: int, placement: pin.SE3, shape: coal.CollisionGeometry) -> int:
        unique = f"{len(self.names)}:{name}"
        self.names.append(name)
        return int(self.geometry.addGeometryObject(pin.GeometryObject(unique, joint, placement, shape)))


@lru_cache(maxsize=8)
def _arm_geometry(robot: RobotModel) -> pin.GeometryModel:
    return pin.buildGeomFromUrdf(robot.kinematics, str(robot.urdf), pin.GeometryType.COLLISION)


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


def _smaller(box: Box, tolerance: float) -> Box:
    x, y, z = (max(edge - 2 * tolerance, 1e-4) for edge in box.size)
    return replace(box, size=(x, y, z))


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
    """All of range(n), ends first and then by halving, so that a blocked path is found early."""
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
