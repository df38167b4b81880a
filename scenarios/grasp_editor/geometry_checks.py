"""Geometric checks of a grasp while it is dragged: clearance of the gripper, pad contacts, centre of mass.

The surface is sampled once. A pose is then judged by moving every sample along the closing direction until it meets a
pad, at the same cost for any number of triangles. Whether the grasp holds is decided by a trial in the physics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, apply, invert, make_transform
from pickproof.cell.geometry.bin import Box
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.one_sided import OneSidedGripper
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.workpiece.collision_pieces import CollisionBox, covering_boxes
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.clearance import OpenGripper
from pickproof.grasping.grasp_points import OPENING_MARGIN, GraspPoint, expand, first_pose, opening
from pickproof.grasping.sample import FACING, FREEFORM, INTO, TOUCH
from pickproof.grasping.sample_one_sided import worst_use

SPACING = 0.0008  # [m] between samples, within the limits of their number
FEWEST, MOST = 6_000, 60_000
LEAST_AREA = FREEFORM[1]
WIDTH = 5e-4  # [m] allowed difference of the stated and the measured width
OFF_CENTRE = 2e-3  # [m] allowed displacement of the workpiece by closing


@dataclass(frozen=True)
class GraspVerdict:
    """Result of the checks at one pose of the tool; () and infinite values where the gripper has no closing pads.

    Attributes:
        hits: boxes of the open gripper that penetrate the workpiece, at the grasp or on the line before it.
        width: [m] of the workpiece between the pads when both touch; infinite where a pad meets nothing.
        off_centre: [m] by which closing pushes the workpiece, or the gripper, along the closing direction.
        areas: [m2] of the face under the left and the right pad.
        angles: [rad] between the surface and the left and the right pad where they touch.
        com_offset: [m] of the centre of mass from the line along which the jaws close, or from the approach axis.
        use: largest share of any load limit of cups or magnets in an accelerated lift, below 1 holds; None for jaws.
    """

    hits: tuple[str, ...]
    width: float
    off_centre: float
    areas: tuple[float, ...]
    angles: tuple[float, ...]
    com_offset: float
    use: float | None = None


class GraspJudge:
    """Judges grasps of one gripper on one workpiece."""

    def __init__(self, workpiece: Workpiece, gripper: Gripper) -> None:
        self.workpiece, self.gripper = workpiece, gripper
        area = float(workpiece.mesh.area)
        n = int(np.clip(area / SPACING**2, FEWEST, MOST))
        self.points, self.normals = workpiece.sample_surface(n, seed=5)
        self._area = area / n

    def judge(self, point: GraspPoint) -> GraspVerdict:
        """The preferred pose of the grasp point."""
        return self.judge_pose(first_pose(point), opening(point), point.approach_distance, point.depths[0])

    def judge_pose(self, T_part_tool: Array, opening: float, before: float = 0.0, pressed: float = 0.0) -> GraspVerdict:
        """One pose of the tool with the pads `opening` [m] apart, come to on a straight line of `before` [m].

        Cups and magnets are pressed on by `pressed` [m] beyond where they touch.
        """
        T = invert(T_part_tool)
        hits = self._hits(T, opening, before)
        com = apply(T, self.workpiece.com[None])[0]
        if isinstance(self.gripper, OneSidedGripper):
            lips = T_part_tool @ make_transform(t=(0.0, 0.0, -pressed))  # where they meet the surface
            use = worst_use(self.workpiece, self.gripper, lips)
            return GraspVerdict(hits, np.inf, 0.0, (), (), float(np.hypot(com[0], com[1])), use)
        assert isinstance(self.gripper, ParallelJaw)
        sides = [self._touch(T, opening, side) for side in (-1.0, 1.0)]
        (left, *_), (right, *_) = sides
        return GraspVerdict(
            hits=hits,
            width=opening - left - right,
            off_centre=(left - right) / 2 if np.isfinite(left + right) else 0.0,
            areas=tuple(area for _, area, _ in sides),
            angles=tuple(angle for _, _, angle in sides),
            com_offset=float(np.hypot(com[1], com[2])),
        )

    def doubts(self, verdict: GraspVerdict, point: GraspPoint) -> list[str]:
        """Objections to a grasp, in words; empty where the geometry is fine."""
        said = [f"{' and '.join(verdict.hits)} would penetrate the part"] if verdict.hits else []
        if verdict.use is not None:
            return said + ([] if verdict.use < 1 else ["the faces do not hold here"])
        assert isinstance(self.gripper, ParallelJaw)
        if not np.isfinite(verdict.width):
            return [*said, "a pad does not meet the part"]
        deeper = point.width - verdict.width
        if deeper < -WIDTH or (deeper > WIDTH and self.gripper.groove is None):  # round parts sink into a groove
            said.append(f"the part is {1e3 * verdict.width:.1f} mm wide here, not {1e3 * point.width:.1f} mm")
        if min(verdict.areas) < LEAST_AREA:
            said.append(f"only {1e6 * min(verdict.areas):.0f} mm² of face under a pad")
        if max(verdict.angles) > self.cone:
            said.append(f"a pad meets the surface at {np.rad2deg(max(verdict.angles)):.0f} degrees and slides off")
        if abs(verdict.off_centre) > OFF_CENTRE:
            said.append(f"closing pushes the part by {1e3 * abs(verdict.off_centre):.1f} mm")
        return said

    def fitted(self, point: GraspPoint) -> dict[str, Any]:
        """Fields that put the centre between the faces that the pads meet, and make the width their distance.

        Raises:
            InputError: a pad meets nothing, or the gripper has no pads that close.
        """
        verdict = self.judge(point)
        if not np.isfinite(verdict.width):
            raise InputError("page", "fit", point.name, "a grasp whose pads both meet the part")
        closing = first_pose(point)[:3, 0]
        centre = np.asarray(point.centre) + verdict.off_centre * closing
        width = round(verdict.width, 5)
        fields: dict[str, Any] = {"centre": tuple(round(float(v), 6) + 0.0 for v in centre), "width": width}
        if point.opening is not None and point.opening < width:
            fields["opening"] = width + 2 * OPENING_MARGIN
        return fields

    @property
    def cone(self) -> float:
        """[rad] between pad and surface from which on friction does not hold: dry Coulomb, geometric mean of both."""
        mine = float(getattr(self.gripper, "friction", 1.0))
        return float(np.arctan(np.sqrt(mine * self.workpiece.friction)))

    def free_poses(self, point: GraspPoint) -> tuple[int, int]:
        """Number of poses of a grasp point without collision of the open gripper and the workpiece, and number of
        all.
        """
        poses = expand((point.model_copy(update={"enabled": True}),), self.workpiece)
        shape = OpenGripper.of(self._solid(opening(point)))
        hit = shape.hits_points(poses.Ts_part_tool, self.points, -INTO)
        return int((~hit).sum()), len(hit)

    def _solid(self, opening: float) -> list[Box]:
        """The gripper's boxes but faces of cups and magnets, which are meant to touch and give way."""
        return self.gripper.body_boxes() if isinstance(self.gripper, OneSidedGripper) else self.gripper.boxes(opening)

    def _hits(self, T_tool_part: Array, opening: float, before: float) -> tuple[str, ...]:
        """Boxes with surface in them, each stretched back along the way in."""
        boxes = self._solid(opening)
        back = np.array([0.0, 0.0, before / 2])
        halves = np.array([b.size for b in boxes]) / 2 + back - INTO
        centres = np.array([b.T_world_box[:3, 3] for b in boxes]) - back
        inside = _box_hits(T_tool_part, self.points, centres, halves)
        names = [b.name.replace("_", " ") for b in boxes]
        return tuple(name for name, hit in zip(names, inside, strict=True) if hit)

    def _touch(self, T_tool_part: Array, opening: float, side: float) -> tuple[float, float, float]:
        """Way [m] of one pad until it touches, area [m2] of the face there, and angle [rad] between the two."""
        Ts, halves = self._pieces(opening, side)
        travel, cosine = _travels(T_tool_part, self.points, self.normals, Ts, halves, side, opening)
        least = float(travel.min())
        if not np.isfinite(least):
            return np.inf, 0.0, np.pi / 2
        near = travel < least + TOUCH
        mean = float(np.clip(cosine[near].mean(), -1.0, 1.0))
        return least, float((near & (cosine > FACING)).sum() * self._area), float(np.arccos(mean))

    def _pieces(self, opening: float, side: float) -> tuple[Array, Array]:
        """Ts_box_tool (b, 4, 4) and half lengths (b, 3) of the convex pieces of one finger, grooves not filled."""
        assert isinstance(self.gripper, ParallelJaw)
        link = self.gripper.links()[0 if side < 0 else 1]
        shapes = [s for s in link.shapes if isinstance(s, CollisionBox)]
        flat = [covering_boxes(s)[0] for s in shapes]
        shift = np.eye(4)
        shift[0, 3] = side * opening / 2
        Ts = [shift @ invert(self.gripper.T_flange_tool) @ T for _, T in flat]
        return invert(np.stack(Ts)), np.array([size for size, _ in flat]) / 2


@numba.njit(cache=True)
def _box_hits(T, points, centres, halves):  # type: ignore[no-untyped-def]
    """(b,) bool: one of the points (n, 3), moved by T, is in a box of the tool frame."""
    hit = np.zeros(len(centres), np.bool_)
    p = np.empty(3)
    for i in range(len(points)):
        for m in range(3):
            p[m] = T[m, 0] * points[i, 0] + T[m, 1] * points[i, 1] + T[m, 2] * points[i, 2] + T[m, 3]
        for b in range(len(centres)):
            if (
                abs(p[0] - centres[b, 0]) < halves[b, 0]
                and abs(p[1] - centres[b, 1]) < halves[b, 1]
                and abs(p[2] - centres[b, 2]) < halves[b, 2]
            ):
                hit[b] = True
    return hit


@numba.njit(cache=True)
def _travels(T, points, normals, Ts, halves, side, opening):  # type: ignore[no-untyped-def]
    """For each point (n,): way of the finger along -side x until it meets the point, and the cosine between both faces.

    The point is moved along +side x through every box (slabs); infinite where it is missed or not between the pads.
    """
    n, k = len(points), len(halves)
    travel, cosine = np.full(n, np.inf), np.zeros(n)
    p, q = np.empty(3), np.empty(3)
    for i in range(n):
        for m in range(3):
            p[m] = T[m, 0] * points[i, 0] + T[m, 1] * points[i, 1] + T[m, 2] * points[i, 2] + T[m, 3]
            q[m] = T[m, 0] * normals[i, 0] + T[m, 1] * normals[i, 1] + T[m, 2] * normals[i, 2]
        if q[0] * side <= 0.0 or abs(p[0]) > opening / 2 + 0.01:
            continue
        for b in range(k):
            enter, leave, axis = -np.inf, np.inf, -1
            for m in range(3):
                o = Ts[b, m, 0] * p[0] + Ts[b, m, 1] * p[1] + Ts[b, m, 2] * p[2] + Ts[b, m, 3]
                d = Ts[b, m, 0] * side
                if abs(d) < 1e-12:
                    if abs(o) > halves[b, m]:
                        leave = -np.inf
                    continue
                t0, t1 = (-halves[b, m] - o) / d, (halves[b, m] - o) / d
                if t0 > t1:
                    t0, t1 = t1, t0
                if t0 > enter:
                    enter, axis = t0, m
                leave = min(leave, t1)
            if axis >= 0 and enter < leave and leave > 0.0 and enter < travel[i] and enter > -0.01:
                travel[i] = enter
                sign = 1.0 if Ts[b, axis, 0] * side > 0 else -1.0  # the face that is met looks against the way
                dot = 0.0
                for m in range(3):
                    dot += sign * Ts[b, axis, m] * q[m]
                cosine[i] = dot
    return travel, cosine
