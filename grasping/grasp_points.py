"""Grasp points defined on the CAD, and all tool poses that they allow."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, model_validator

from pickproof.cell.config import Config, Fine, Offset, OffsetPoint, Small, parse, read_yaml
from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, about_axis, make_transform
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.workpiece.workpiece import Workpiece

Triple = tuple[float, float, float]
OPENING_MARGIN = 0.0025  # [m] on each side of the workpiece before the jaws close
MAX_TILT_DEG = 50.0  # [deg] default for the largest angle between the approach and the preferred one in the world
SAME = 1e-6  # [m, and entries of rotation matrices] difference below which two poses are equal


class Turn(Config):
    """A range of angles in [deg], sampled in steps."""

    from_deg: float = Field(0.0, ge=-180, le=180, description="smallest angle")
    to_deg: float = Field(0.0, ge=-180, le=180, description="largest angle")
    step_deg: float = Field(15.0, gt=0, le=180, description="step between sampled angles")

    @model_validator(mode="after")
    def _ordered(self) -> Turn:
        if self.to_deg < self.from_deg:
            raise ValueError("to_deg must not be below from_deg")
        return self

    def angles(self) -> Array:
        """Angles in [rad], smallest absolute value first."""
        a = np.arange(self.from_deg, self.to_deg + 1e-9, self.step_deg)
        return np.deg2rad(a[np.argsort(np.abs(a), kind="stable")])


class Slide(Config):
    """Freedom to shift the grasp along a direction of the CAD."""

    along: Triple = Field(description="direction in the CAD frame")
    offsets: tuple[Offset, ...] = Field(min_length=1, description="[m], preferred first")

    @model_validator(mode="after")
    def _somewhere(self) -> Slide:
        if np.linalg.norm(self.along) < 1e-6:
            raise ValueError("along must not be zero")
        return self


class GraspPoint(Config):
    """One entry of grasps.yaml; vectors and [m] in the CAD frame.

    The tool pose is given by `centre` (between the pads), `approach` (tool z) and `closing` (tool x); the tip ends
    (TCP) go `depth` past the centre along the approach, the first depth for which there is room.
    """

    name: str = Field(min_length=1, description="unique in the file; records and reports show it")
    gripper: str | None = Field(None, min_length=1, description="its gripper; that of the table when left out")
    centre: OffsetPoint = Field(description="[m] point between the pads")
    approach: Triple = Field(description="direction of approach: tool z")
    closing: Triple = Field(description="direction in which the jaws close, tool x; at right angles to `approach`")
    width: Small = Field(description="[m] width of the workpiece between the pads")
    opening: Small | None = Field(None, description="[m] during the approach; width + 5 mm when left out")
    stroke: Small | None = Field(None, description="[m] travel of the jaws when they close; excludes `opening`")
    depths: tuple[Offset, ...] = Field(
        (0.004,), min_length=1, description="[m] of the tips past the centre, preferred first"
    )
    approach_distance: Small = Field(0.06, description="[m] straight line before the grasp")
    retract_distance: Small = Field(0.10, description="[m] straight line up after it")
    priority: float = Field(1.0, ge=0, le=1, description="a term of the rank")
    tolerance: Fine = Field(0.003, gt=0, description="[m] largest pose error at which the grasp still holds")
    robustness: float = Field(
        1.0, ge=0, le=1, description="share of disturbed poses at which the grasp held, a term of the rank"
    )
    enabled: bool = Field(True, description="false keeps the entry but does not use it")
    symmetry: bool = Field(True, description="repeat the grasp at all symmetric places of the workpiece")
    world_approach: Triple = Field(
        (0.0, 0.0, -1.0), description="preferred approach in the world; tilt is measured from it"
    )
    max_tilt_deg: float = Field(MAX_TILT_DEG, ge=0, le=180, description="of the approach against `world_approach`")
    flip: bool = Field(True, description="the tool may be turned by 180 degrees about the approach")
    tool_rotation: Turn = Field(Turn(), description="freedom of the tool about the closing direction")
    approach_rotation: Turn = Field(Turn(), description="freedom of the tool about its approach, in addition to `flip`")
    part_rotation: Turn = Field(Turn(), description="freedom of the part about part_axis, for round parts")
    part_axis: Triple = Field((0.0, 0.0, 1.0), description="axis of `part_rotation` through the CAD origin")
    slide: Slide | None = Field(None, description="positions along a direction where the grasp is equally good")

    @model_validator(mode="after")
    def _right_angle(self) -> GraspPoint:
        a, c = np.asarray(self.approach), np.asarray(self.closing)
        for name in ("approach", "closing", "part_axis", "world_approach"):
            if np.linalg.norm(getattr(self, name)) < 1e-6:
                raise ValueError(f"{name} must not be zero")
        if self.opening is not None and self.stroke is not None:
            raise ValueError("opening and stroke exclude each other")
        if self.opening is not None and self.opening < self.width:
            raise ValueError("opening must not be below width")
        if abs(a @ c) > 1e-3 * np.linalg.norm(a) * np.linalg.norm(c):
            raise ValueError("approach and closing must be at right angles")
        return self


class GraspTable(Config):
    """Schema of grasps.yaml."""

    gripper: str = Field(min_length=1, description="gripper of the table; must be that of the scenario")
    grasps: list[GraspPoint] = Field(min_length=1, description="the grasp points")


@dataclass(frozen=True)
class GraspPoses:
    """Every tool pose that the grasp points allow, symmetries and freedoms expanded.

    Attributes:
        points: the grasp points.
        index: (n,) which grasp point each pose belongs to.
        Ts_part_tool: (n, 4, 4) of the TCP.
        openings: (n,) of the jaws during the approach, in [m].
        depth_rank: (n,) 0 for the preferred depth.
        offset: (n,) [m] shift from the centre of the grasp point.
        disabled: grasp point that is switched off -> number of poses it would have.
        no_place: grasp point -> number of poses left out, because the workpiece cannot be placed as required from them.
    """

    points: tuple[GraspPoint, ...]
    index: np.ndarray
    Ts_part_tool: Array
    openings: Array
    depth_rank: np.ndarray
    offset: Array
    disabled: dict[str, int] = field(default_factory=dict)
    no_place: dict[str, int] = field(default_factory=dict)

    def placeable(self, can: np.ndarray) -> GraspPoses:
        """The poses with `can` (n,) bool, from which the workpiece can be placed; the others are only counted."""
        names = Counter(self.points[i].name for i in self.index[~can])
        return GraspPoses(
            points=self.points,
            index=self.index[can],
            Ts_part_tool=self.Ts_part_tool[can],
            openings=self.openings[can],
            depth_rank=self.depth_rank[can],
            offset=self.offset[can],
            disabled=self.disabled,
            no_place=dict(names),
        )


def load_grasps(workpiece: Workpiece, gripper: Gripper, path: Path | None = None) -> GraspPoses:
    """Read a workpiece's grasps.yaml, or the table at `path`, and expand the grasp points for `gripper`.

    Raises:
        InputError: missing file, a field that does not fit the schema, or a grasp that the gripper cannot do.
    """
    path = path or workpiece.folder / "grasps.yaml"
    table = read_table(path)
    points = tuple(g if g.gripper else g.model_copy(update={"gripper": table.gripper}) for g in table.grasps)
    made_for = sorted({str(p.gripper) for p in points})
    if gripper.name not in made_for:
        field, found = ("gripper", table.gripper) if made_for == [table.gripper] else ("grasps", ", ".join(made_for))
        raise InputError(path, field, found, f"{gripper.name}, the scenario's gripper")
    check_openings(points, gripper, path)
    return expand(points, workpiece, gripper.name)


def read_table(path: Path) -> GraspTable:
    """Read a grasps.yaml.

    Raises:
        InputError: missing file, a field that does not fit the schema, or a name given twice.
    """
    return parse_table(read_yaml(path), path)


def parse_table(data: dict[str, Any], path: Path) -> GraspTable:
    """Check `data`, the content of a grasps.yaml at `path`; errors are those of `read_table`."""
    table = parse(GraspTable, data, path)
    names = [g.name for g in table.grasps]
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(path, f"grasps.{i}.name", name, "a name that no other grasp point has")
    return table


def check_openings(points: Sequence[GraspPoint], gripper: Gripper, path: Path) -> None:
    """Check the openings of grasp points for a jaw.

    Raises:
        InputError: an opening exceeds the gripper's largest opening.
    """
    for i, point in enumerate(points if isinstance(gripper, ParallelJaw) else ()):
        if point.gripper == gripper.name and opening(point) > gripper.max_opening:
            raise InputError(path, f"grasps.{i}.opening", opening(point), f"at most {gripper.max_opening} m")


def opening(point: GraspPoint) -> float:
    """Opening of the jaws during the approach, in [m]."""
    if point.opening is not None:
        return point.opening
    return point.width + (2 * OPENING_MARGIN if point.stroke is None else point.stroke)


def expand(points: tuple[GraspPoint, ...], workpiece: Workpiece, gripper: str = "") -> GraspPoses:
    """All tool poses of the grasp points over symmetry, slides, depths, rotations and flips, each pose once.

    Poses of grasp points that are switched off, or for another gripper than the one named, are only counted.
    """
    rows: list[_Rows] = []
    disabled: dict[str, int] = {}
    for i, point in enumerate(points):
        mine = _expand_one(i, point, workpiece)
        if point.enabled and (not gripper or point.gripper in (None, gripper)):
            rows.append(mine)
        else:
            disabled[point.name] = len(mine.index)
    if not rows:
        rows = [_Rows(np.zeros(0, np.intp), np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0, np.intp), np.zeros(0))]
    return GraspPoses(
        points,
        np.concatenate([r.index for r in rows]),
        np.concatenate([r.Ts for r in rows]),
        np.concatenate([r.openings for r in rows]),
        np.concatenate([r.ranks for r in rows]),
        np.concatenate([r.offsets for r in rows]),
        disabled,
    )


@dataclass(frozen=True)
class _Rows:
    """Poses of one grasp point; the fields are those of GraspPoses."""

    index: np.ndarray
    Ts: Array
    openings: Array
    ranks: np.ndarray
    offsets: Array


def first_pose(point: GraspPoint) -> Array:
    """Preferred T_part_tool (4, 4) of a grasp point: first slide and depth, smallest rotations, no symmetry."""
    return _tool_poses(point, point.slide.offsets[0] if point.slide else 0.0, point.depths[0])[0]


def _expand_one(i: int, point: GraspPoint, workpiece: Workpiece) -> _Rows:
    """Every pose of grasp point `i`; of equal poses from symmetry and freedoms, only the preferred one."""
    Ts: list[Array] = []
    ranks: list[int] = []
    offsets: list[float] = []
    for S in workpiece.symmetry.rotations() if point.symmetry else np.eye(3)[None]:
        for offset in point.slide.offsets if point.slide else (0.0,):
            for rank, depth in enumerate(point.depths):
                poses = make_transform(S) @ _tool_poses(point, offset, depth)
                Ts.extend(poses)
                ranks += [rank] * len(poses)
                offsets += [abs(offset)] * len(poses)
    stack = np.asarray(Ts).reshape(-1, 4, 4)
    wanted = np.lexsort((np.arange(len(ranks)), np.asarray(offsets), np.asarray(ranks)))
    _, first = np.unique(np.rint(stack[wanted, :3].reshape(len(stack), -1) / SAME) + 0.0, axis=0, return_index=True)
    keep = np.sort(wanted[first])
    return _Rows(
        np.full(len(keep), i, dtype=np.intp),
        stack[keep],
        np.full(len(keep), opening(point)),
        np.asarray(ranks, dtype=np.intp)[keep],
        np.asarray(offsets)[keep],
    )


def _tool_poses(point: GraspPoint, offset: float, depth: float) -> Array:
    """Ts_part_tool (n, 4, 4) of one grasp point over its rotations and flips."""
    z = np.asarray(point.approach) / np.linalg.norm(point.approach)
    x = np.asarray(point.closing) / np.linalg.norm(point.closing)
    centre = np.asarray(point.centre)
    if point.slide is not None:
        centre = centre + offset * np.asarray(point.slide.along) / np.linalg.norm(point.slide.along)
    T_part_grip = make_transform(np.stack([x, np.cross(z, x), z], axis=1), centre)
    axis = np.asarray(point.part_axis) / np.linalg.norm(point.part_axis)
    part_turns = about_axis(axis, point.part_rotation.angles())
    tool_turns = about_axis((1, 0, 0), point.tool_rotation.angles())
    spins = about_axis((0, 0, 1), point.approach_rotation.angles())
    flips = about_axis((0, 0, 1), np.array([0.0, np.pi] if point.flip else [0.0]))
    in_grip = (tool_turns[:, None, None] @ spins[None, :, None] @ flips[None, None, :]).reshape(-1, 4, 4)
    return (part_turns[:, None] @ T_part_grip @ in_grip @ make_transform(t=(0.0, 0.0, depth))).reshape(-1, 4, 4)
