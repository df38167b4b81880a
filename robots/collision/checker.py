"""Collisions at one joint vector: Pinocchio's geometry for one gripper, one held part and one ground, by mode."""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import coal
import numpy as np
import pinocchio as pin

from pickproof.cell.frames import Array
from pickproof.cell.geometry.bin import Box
from pickproof.robots.collision.held_part import HeldPart, Shape, shapes
from pickproof.robots.failure import Contact
from pickproof.robots.kinematics.model import RobotModel

Mode = Literal["transit", "contact", "depart", "leave"]
Ground = tuple[coal.CollisionGeometry, pin.SE3]

CLEARANCE_MARGIN = 0.003  # [m] clearance margin of blended motions


class Checker:
    """Pinocchio's geometry for one held part, with the relevant pairs only."""

    def __init__(
        self,
        robot: RobotModel,
        obstacles: tuple[Box, ...],
        tool_boxes: tuple[Box, ...],
        pile: Ground | None,
        placed: Ground | None,
        held: HeldPart | None,
        tolerance: float,
        kept_clear: frozenset[str],
    ) -> None:
        self.model = robot.kinematics
        self.data = self.model.createData()
        self.geometry = _arm_geometry(robot).copy()
        frames = self.model.frames
        links = [(i, int(g.parentJoint)) for i, g in enumerate(self.geometry.geometryObjects)]
        self.names = [frames[g.parentFrame].name for g in self.geometry.geometryObjects]
        last = self.model.njoints - 1
        T_joint_flange = frames[robot.flange].placement

        tool = [self._add(b.name, last, T_joint_flange, b) for b in tool_boxes]
        self._held, self._tolerance, self._T_joint_flange = held, tolerance, T_joint_flange
        self._shapes = () if held is None else (*shapes(held.pieces), *shapes(held.pieces, tolerance))
        self._parts = [self._add_shape("held", last, T, shape) for shape, T in self._placed_shapes()]
        part, slim = self._parts[: len(self._parts) // 2], self._parts[len(self._parts) // 2 :]
        fixed = [self._add(b.name, 0, pin.SE3.Identity(), b) for b in obstacles]
        self._ground = pile
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
        self._cleared_pairs = {
            name: [k for k, p in enumerate(pairs) if name in (self.names[p[0]], self.names[p[1]])]
            for name in kept_clear
        }
        self._carried = {*tool, *part, *slim}
        self._mode: Mode | None = None
        self._margin, self._kept_clear = 0.0, frozenset[str]()
        self._sort()

    def takes(self, held: HeldPart | None, tolerance: float) -> bool:
        """Move the held pieces to another pose; False where the pieces differ."""
        if held is None or self._held is None or tolerance != self._tolerance or held.pieces != self._held.pieces:
            return held is self._held
        if held is not self._held:
            self._held = held
            for k, (_, T) in zip(self._parts, self._placed_shapes(), strict=True):
                self.geometry.geometryObjects[k].placement = T
        return True

    def _placed_shapes(self) -> list[Shape]:
        """Pieces of the held part, then the reduced ones, in the frame of the last joint."""
        if self._held is None:
            return []
        T = self._T_joint_flange * pin.SE3(np.array(self._held.T))
        return [(shape, T * T_part_shape) for shape, T_part_shape in self._shapes]

    def stand_over(self, ground: Ground | None) -> None:
        """Replace the ground of the checks."""
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
        """Check the pairs of a mode; in `transit` with a clearance margin to the obstacles named in `kept`."""
        kept_clear = kept if mode == "transit" else frozenset[str]()
        if kept_clear != self._kept_clear:
            self._kept_clear, self._margin = kept_clear, -1.0
        if mode != self._mode:
            for other, pairs in self._only.items():
                data = self.geometry_data
                switch = data.activateCollisionPair if other == mode else data.deactivateCollisionPair
                for k in pairs:
                    switch(k)
            self._mode = mode

    def free(self, q: Array, margin: float = 0.0) -> bool:
        """Whether all pairs are more than `margin` [m] apart at q (6,)."""
        if margin != self._margin:
            requests = self.geometry_data.collisionRequests
            for request in requests:
                request.security_margin = margin
            for name in self._kept_clear:
                for k in self._cleared_pairs[name]:
                    requests[k].security_margin = margin + CLEARANCE_MARGIN
            self._margin = margin
        return not pin.computeCollisions(self.model, self.data, self.broadphase, q, True)

    def contact(self, q: Array) -> Contact | None:
        """The first pair that touches at q (6,); None where there is none."""
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
