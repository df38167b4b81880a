"""Import and export of `isaac_grasp` files, format version 1.0: grasps as poses of a gripper frame on an object.

The format is that of Isaac Sim's Grasp Editor (docs.isaacsim.omniverse.nvidia.com, "What is an Isaac Grasp File?"):
lengths in [m], the orientation a quaternion {w, xyz}, joints of the gripper at the grasp and before it. Isaac ROS
writes `object_frame` and `gripper_frame` where Isaac Sim writes `object_frame_link` and `gripper_frame_link`; both are
read, the latter are written. Additional fields of other programs are ignored.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, field_validator, model_validator

from pickproof.cell.config import Config, OffsetPoint, parse, read_yaml, yaml_text
from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, from_quat_xyzw, invert, to_quat_xyzw
from pickproof.grasping.grasp_points import GraspPoint, GraspPoses

Triple = tuple[float, float, float]
JOINTS = ("finger_left_joint", "finger_right_joint")
"""Prismatic joints of this project's jaws, each 0 where its pad is at the centre."""


class _Open(Config):
    """Base of the file's models; unknown fields are ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class _Orientation(_Open):
    w: float
    xyz: Triple

    @model_validator(mode="after")
    def _unit(self) -> _Orientation:
        length = float(np.linalg.norm([self.w, *self.xyz]))
        if not 0.99 < length < 1.01:
            raise ValueError(f"a unit quaternion is needed, its length is {length:.3g}")
        return self


class _Grasp(_Open):
    confidence: float = Field(ge=0, le=1)
    position: OffsetPoint
    orientation: _Orientation
    cspace_position: dict[str, float] = Field(min_length=1)
    pregrasp_cspace_position: dict[str, float] = Field(min_length=1)


class _File(_Open):
    format: Literal["isaac_grasp"]
    format_version: float | str
    grasps: dict[str, _Grasp] = Field(min_length=1)

    @field_validator("format_version")
    @classmethod
    def _known(cls, version: float | str) -> float | str:
        if str(version) not in ("1", "1.0"):
            raise ValueError("only version 1.0 is supported")
        return version


def read_isaac_grasps(path: Path, T_gripper_tool: Array) -> list[GraspPoint]:
    """Grasp points without any freedom, one for each grasp of an `isaac_grasp` file.

    Args:
        T_gripper_tool: (4, 4) TCP of this project in the file's gripper frame; x closing direction, z approach.

    Raises:
        InputError: the file is not an `isaac_grasp` file, or its joints are not an opening of a parallel jaw.
    """
    file = parse(_File, read_yaml(path), path)
    points = []
    for name, grasp in file.grasps.items():
        quat_xyzw = (*grasp.orientation.xyz, grasp.orientation.w)
        T_part_tool = from_quat_xyzw(grasp.position, quat_xyzw) @ T_gripper_tool
        width = _opening(path, f"grasps.{name}.cspace_position", grasp.cspace_position)
        wide = _opening(path, f"grasps.{name}.pregrasp_cspace_position", grasp.pregrasp_cspace_position)
        if wide < width:
            raise InputError(
                path, f"grasps.{name}.pregrasp_cspace_position", wide, f"at least {width} m, the width at the grasp"
            )
        points.append(_point(name, T_part_tool, width, wide, grasp.confidence))
    return points


def isaac_grasps_text(poses: GraspPoses, workpiece: str, gripper: str, T_gripper_tool: Array) -> str:
    """An `isaac_grasp` file of every pose of `poses`, freedoms and symmetry expanded, best grasp points first.

    Args:
        T_gripper_tool: (4, 4) TCP of this project in the gripper frame of the program that reads the file.
    """
    numbered = {p.name: 0 for p in poses.points}
    order = sorted(range(len(poses.index)), key=lambda i: -poses.points[poses.index[i]].priority)
    grasps: dict[str, Any] = {}
    for i in order:
        point = poses.points[poses.index[i]]
        T = poses.Ts_part_tool[i] @ invert(T_gripper_tool)
        x, y, z, w = _plain(to_quat_xyzw(T))
        grasps[f"{point.name}_{numbered[point.name]}"] = {
            "confidence": point.priority,
            "position": _plain(T[:3, 3]),
            "orientation": {"w": w, "xyz": [x, y, z]},
            "cspace_position": dict.fromkeys(JOINTS, point.width / 2),
            "pregrasp_cspace_position": dict.fromkeys(JOINTS, float(poses.openings[i]) / 2),
        }
        numbered[point.name] += 1
    head = {
        "format": "isaac_grasp",
        "format_version": 1.0,
        "object_frame_link": workpiece,
        "gripper_frame_link": gripper,
        "grasps": grasps,
    }
    return yaml_text(head)


def _point(name: str, T_part_tool: Array, width: float, wide: float, confidence: float) -> GraspPoint:
    centre, approach, closing = (_plain(T_part_tool[:3, column]) for column in (3, 2, 0))
    return GraspPoint.model_validate(
        {
            "name": name,
            "centre": centre,
            "approach": approach,
            "closing": closing,
            "width": width,
            "opening": wide,
            "depths": (0.0,),
            "priority": confidence,
            "flip": False,
            "symmetry": False,
        }
    )


def _plain(values: Array) -> list[float]:
    """Numbers for a file, rounded well below any tolerance; -0 becomes 0."""
    return [round(float(v), 12) + 0.0 for v in values]


def _opening(path: Path, field: str, joints: dict[str, float]) -> float:
    """Distance of the pads in [m]: the sum of both fingers, or twice one finger if the other is a mimic joint."""
    if len(joints) > 2:
        raise InputError(path, field, ", ".join(joints), "one or two prismatic finger joints")
    travel = [abs(v) for v in joints.values()]
    opening = float(sum(travel)) * (2 if len(travel) == 1 else 1)
    if not 0 < opening <= 0.5:
        raise InputError(path, field, opening, "finger joints in [m] with a sum above 0 and up to 0.5")
    return opening
