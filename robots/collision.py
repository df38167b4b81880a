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
from cell.frames import Array, apply, make_transform
from robots.inverse import flange_poses
from robots.model import RobotModel

Mode = Literal["transit", "contact"]
Contact = tuple[str, str]

MAX_JOINT_STEP = 0.01  # [rad] between two checks of a path
MAX_TIP_STEP = 0.008  # [m]; no body is thinner than 3 mm, so a wall of 6 mm cannot slip between two checks


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

    Mode `transit` checks everything. Mode `contact`, for the last line to a grasp and the first line after it, ignores
    fingers and held part against the height field, and shrinks the held part by its pose tolerance; walls and table
    count.
    """

    def __init__(
        self,
        robot: RobotModel,
        tool_boxes: Sequence[Box],
        obstacles: Sequence[Box],
        heightfield: HeightField | None = None,
    ) -> None:
        self.robot = robot
        self.tool_boxes, self.obstacles, self.heightfield = tuple(tool_boxes), tuple(obstacles), heightfield
        self._ground = None if heightfield is None else _ground(heightfield)
        self._held: tuple[Box, ...] = ()
        self._tolerance = 0.0
        self._checkers: dict[tuple[Mode, bool], _Checker] = {}

    def hold(self, boxes_flange: Sequence[Box], tolerance: float = 0.005) -> None:
        """Attach a part, given as boxes in the flange frame; in mode `contact` it is `tolerance` [m] smaller all round.

        A part at rest touches floor, walls and neighbours; the tolerance keeps an error of its estimated pose from
        reading as a collision.
        """
        self._held, self._tolerance = tuple(boxes_flange), tolerance
        self._checkers = {key: c for key, c in self._checkers.items() if not key[1]}

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

    def free(self, q: Array, mode: Mode = "transit") -> bool:
        """Whether nothing touches at q (6,) in [rad]."""
        return self._checker(mode).free(q)

    def first_contact(self, q: Array, mode: Mode = "transit") -> Contact | None:
        """Names of one pair that touches at q (6,) in [rad]: link, tool box or `held`, then what it touches."""
        return self._checker(mode).contact(q)

    def free_path(self, qs: Array, mode: Mode = "transit") -> bool:
        """Whether the polyline qs (n, 6) in [rad] is free, checked every 0.01 rad and 8 mm of tip travel at most."""
        checker, samples = self._checker(mode), self._samples(qs)
        return all(checker.free(samples[i]) for i in _coarse_to_fine(len(samples)))

    def path_contact(self, qs: Array, mode: Mode = "transit") -> Contact | None:
        """Like `free_path`, but names a pair that touches somewhere on the way, or None."""
        checker, samples = self._checker(mode), self._samples(qs)
        hit = next((i for i in _coarse_to_fine(len(samples)) if not checker.free(samples[i])), None)
        return None if hit is None else checker.contact(samples[hit])

    def _samples(self, qs: Array) -> Array:
        """The polyline with steps of at most MAX_JOINT_STEP and MAX_TIP_STEP; dense input is thinned."""
        qs = np.asarray(qs, dtype=np.float64).reshape(-1, 6)
        length = np.abs(np.diff(qs, axis=0)).max(axis=1, initial=0.0) / MAX_JOINT_STEP
        s = np.concatenate([[0.0], np.cumsum(length)])
        corners = s[1:-1][(length[:-1] > 0.5) | (length[1:] > 0.5)]
        at = np.union1d(np.linspace(0.0, s[-1], int(np.ceil(s[-1])) + 1), corners)
        samples = _at_length(s, qs, at)
        # Points of a rigid body move furthest at its corners; links are too thick to slip through anything.
        tips = apply(flange_poses(self.robot, samples), self._tool_corners())
        travel = np.linalg.norm(np.diff(tips, axis=0), axis=-1).max(axis=1, initial=0.0)
        if travel.max(initial=0.0) <= MAX_TIP_STEP:
            return samples
        more = np.ceil(travel / MAX_TIP_STEP)
        fine = np.interp(np.arange(more.sum() + 1), np.concatenate([[0.0], np.cumsum(more)]), at)
        return _at_length(s, qs, fine)

    def _tool_corners(self) -> Array:
        """Corners (n, 3) of tool and held part in the flange frame."""
        return np.concatenate([np.zeros((1, 3)), *(_corners(b) for b in (*self.tool_boxes, *self._held))])

    def _checker(self, mode: Mode) -> _Checker:
        key = (mode, bool(self._held))
        if key not in self._checkers:
            held = self._held
            if mode == "contact":
                shrunk = [np.maximum(np.array(b.size) - 2 * self._tolerance, 1e-4) for b in held]
                held = tuple(replace(b, size=tuple(s)) for b, s in zip(held, shrunk, strict=True))
            self._checkers[key] = _Checker(self, held, mode)
        return self._checkers[key]


class _Checker:
    """Pinocchio's geometry for one mode and one held part, with only the pairs that count."""

    def __init__(self, scene: CollisionScene, held: tuple[Box, ...], mode: Mode) -> None:
        self.model = scene.robot.kinematics
        self.data = self.model.createData()
        self.geometry = _arm_geometry(scene.robot).copy()
        frames = self.model.frames
        links = [(i, int(g.parentJoint)) for i, g in enumerate(self.geometry.geometryObjects)]
        self.names = [frames[g.parentFrame].name for g in self.geometry.geometryObjects]
        last = self.model.njoints - 1
        T_joint_flange = frames[scene.robot.flange].placement

        tool = [self._add(b.name, last, T_joint_flange, b) for b in scene.tool_boxes]
        part = [self._add("held", last, T_joint_flange, b) for b in held]
        fixed = [self._add(b.name, 0, pin.SE3.Identity(), b) for b in scene.obstacles]

        pairs = [(a, b) for a, i in links for b, j in links if j - i >= 2]
        pairs += [(t, a) for t in tool for a, i in links if i <= 4]
        pairs += [(p, a) for p in part for a, i in links if i <= 5]
        moving = [a for a, i in links if i > 0] + tool + part
        pairs += [(m, f) for m in moving for f in fixed]
        if scene._ground is not None:
            shape, T_world_ground = scene._ground
            ground = self._add_shape("pile", 0, T_world_ground, shape)
            fingers = {t for t in tool if self.names[t].startswith("finger")}
            touching = fingers | set(part) if mode == "contact" else set()
            pairs += [(m, ground) for m in moving if m not in touching]
        for a, b in pairs:
            self.geometry.addCollisionPair(pin.CollisionPair(a, b))
        self.geometry_data = self.geometry.createData()
        self.broadphase = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(
            self.model, self.geometry, self.geometry_data
        )

    def free(self, q: Array) -> bool:
        return not pin.computeCollisions(self.model, self.data, self.broadphase, q, True)

    def contact(self, q: Array) -> Contact | None:
        if not pin.computeCollisions(self.model, self.data, self.geometry, self.geometry_data, q, True):
            return None
        for pair, result in zip(self.geometry.collisionPairs, self.geometry_data.collisionResults, strict=True):
            if result.isCollision():
                return self.names[pair.first], self.names[pair.second]
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


def _ground(field: HeightField) -> tuple[coal.CollisionGeometry, pin.SE3]:
    """Coal's height field is centred at its origin and its row 0 is at +y; ours starts at y0."""
    ny, nx = field.heights.shape
    dx, dy = (nx - 1) * field.step, (ny - 1) * field.step
    z = np.ascontiguousarray(field.heights[::-1], dtype=np.float64)
    shape = coal.HeightFieldAABB(dx, dy, z, float(z.min()) - 0.02)
    return shape, pin.SE3(np.eye(3), np.array([field.x0 + dx / 2, field.y0 + dy / 2, 0.0]))


def _corners(box: Box) -> Array:
    signs = np.array(list(np.ndindex(2, 2, 2)), dtype=np.float64) - 0.5
    return apply(make_transform(box.T_world_box[:3, :3], box.T_world_box[:3, 3]), signs * np.array(box.size))


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
