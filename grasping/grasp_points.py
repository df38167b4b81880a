"""Grasp points defined on the CAD, and all tool poses that they allow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field, model_validator

from cell.config import Config, load
from cell.errors import InputError
from cell.frames import Array, about_axis, make_transform
from cell.gripper import Gripper
from cell.workpiece import Workpiece

Triple = tuple[float, float, float]
OPENING_MARGIN = 0.0025  # [m] on each side of the workpiece before the jaws close


class Turn(Config):
    """A range of angles in [deg], sampled in steps."""

    from_deg: float = Field(0.0, ge=-180, le=180)
    to_deg: float = Field(0.0, ge=-180, le=180)
    step_deg: float = Field(15.0, gt=0, le=180)

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
    """Freedom to grip elsewhere along a direction of the CAD."""

    along: Triple
    offsets: tuple[float, ...] = Field(min_length=1, description="[m], most wanted first")

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

    name: str
    centre: Triple
    approach: Triple
    closing: Triple
    width: float = Field(gt=0, description="[m] of the workpiece between the pads")
    opening: float | None = Field(None, gt=0, description="[m] of the jaws on the way in; width + 5 mm when left out")
    depths: tuple[float, ...] = Field((0.004,), min_length=1, description="[m] tips past the centre, most wanted first")
    approach_distance: float = Field(0.06, gt=0, le=0.5, description="[m] straight line before the grasp")
    retract_distance: float = Field(0.10, gt=0, le=0.5, description="[m] straight line up after it")
    priority: float = Field(1.0, ge=0, le=1)
    tolerance: float = Field(0.003, gt=0, description="[m] error of the pose under which the grasp still holds")
    enabled: bool = True
    flip: bool = Field(True, description="the tool may be turned by 180 degrees about the approach")
    tool_rotation: Turn = Field(Turn(), description="freedom of the tool about the closing direction")
    part_rotation: Turn = Field(Turn(), description="freedom of the part about part_axis, for round parts")
    part_axis: Triple = (0.0, 0.0, 1.0)
    slide: Slide | None = None

    @model_validator(mode="after")
    def _right_angle(self) -> GraspPoint:
        a, c = np.asarray(self.approach), np.asarray(self.closing)
        if min(np.linalg.norm(a), np.linalg.norm(c), np.linalg.norm(self.part_axis)) < 1e-6:
            raise ValueError("approach, closing and part_axis must not be zero")
        if abs(a @ c) > 1e-3 * np.linalg.norm(a) * np.linalg.norm(c):
            raise ValueError("approach and closing must be at right angles")
        return self


class GraspTable(Config):
    """Schema of grasps.yaml."""

    gripper: str
    grasps: list[GraspPoint] = Field(min_length=1)


@dataclass(frozen=True)
class GraspPoses:
    """Every tool pose that the grasp points allow, symmetries and freedoms expanded.

    Attributes:
        points: the grasp points.
        index: (n,) which grasp point each pose belongs to.
        Ts_part_tool: (n, 4, 4) of the TCP.
        openings: (n,) of the jaws on the way in, in [m].
        depth_rank: (n,) 0 for the most wanted depth.
        offset: (n,) [m] slid away from the centre of the grasp point.
    """

    points: tuple[GraspPoint, ...]
    index: np.ndarray
    Ts_part_tool: Array
    openings: Array
    depth_rank: np.ndarray
    offset: Array


def load_grasps(workpiece: Workpiece, gripper: Gripper) -> GraspPoses:
    """Read a workpiece's grasps.yaml and expand it.

    Raises:
        InputError: missing file, a field that does not fit the schema, or a grasp that the gripper cannot do.
    """
    path = workpiece.folder / "grasps.yaml"
    table = load(GraspTable, path)
    if table.gripper != gripper.name:
        raise InputError(path, "gripper", table.gripper, f"{gripper.name}, the scenario's gripper")
    names = [g.name for g in table.grasps]
    for i, point in enumerate(table.grasps):
        if point.name in names[:i]:
            raise InputError(path, f"grasps.{i}.name", point.name, "a name of its own")
        if opening(point) > gripper.max_opening:
            raise InputError(path, f"grasps.{i}.opening", opening(point), f"at most {gripper.max_opening} m")
    return expand(tuple(table.grasps), workpiece)


def opening(point: GraspPoint) -> float:
    """Opening of the jaws on the way in, in [m]."""
    return point.opening if point.opening is not None else point.width + 2 * OPENING_MARGIN


def expand(points: tuple[GraspPoint, ...], workpiece: Workpiece) -> GraspPoses:
    """All tool poses of the enabled grasp points over symmetry, slides, depths, rotations and flips."""
    index: list[int] = []
    Ts: list[Array] = []
    openings: list[float] = []
    ranks: list[int] = []
    offsets: list[float] = []
    for i, point in enumerate(points):
        if not point.enabled:
            continue
        for S in workpiece.symmetry.rotations():
            for offset in point.slide.offsets if point.slide else (0.0,):
                for rank, depth in enumerate(point.depths):
                    poses = make_transform(S) @ _tool_poses(point, offset, depth)
                    Ts.extend(poses)
                    index += [i] * len(poses)
                    openings += [opening(point)] * len(poses)
                    ranks += [rank] * len(poses)
                    offsets += [abs(offset)] * len(poses)
    return GraspPoses(
        points,
        np.asarray(index, dtype=np.intp),
        np.asarray(Ts).reshape(-1, 4, 4),
        np.asarray(openings),
        np.asarray(ranks, dtype=np.intp),
        np.asarray(offsets),
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
    flips = about_axis((0, 0, 1), np.array([0.0, np.pi] if point.flip else [0.0]))
    T_grip_tool = make_transform(t=(0.0, 0.0, depth))
    all_turns = part_turns[:, None, None] @ T_part_grip @ tool_turns[None, :, None] @ flips[None, None, :]
    return (all_turns @ T_grip_tool).reshape(-1, 4, 4)
