"""Grasp tables as the `grasps` commands need them: the gripper a table is for, and tables of other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pickproof.cell.config import read_yaml
from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.grasping.grasp_points import GraspPoint
from pickproof.grasping.isaac_grasp import read_isaac_grasps

GRIPPER = "jaw_v1"
"""Gripper where no table names one."""


def workpiece_and_gripper(name: str, gripper: str | None, table: Path | None = None) -> tuple[Workpiece, Gripper]:
    """The workpiece, and the gripper that was named or that its table is for."""
    workpiece = load_workpiece(name)
    return workpiece, load_gripper(gripper or gripper_of(table or workpiece.folder / "grasps.yaml"))


def gripper_of(path: Path) -> str:
    """The gripper that a table is for, as far as the table can be read."""
    try:
        return str(read_yaml(path).get("gripper", GRIPPER))
    except InputError:
        return GRIPPER  # the reader of the table reports its errors


def imported(file: Path, T_hand_tool: Array, workpiece: Workpiece, gripper: Gripper) -> list[GraspPoint]:
    """The grasps of an isaac_grasp file.

    Args:
        T_hand_tool: our tool centre point in the other program's gripper frame, lengths in [m].

    Raises:
        InputError: no such file, or grasps that this gripper cannot take on this workpiece.
    """
    points = read_isaac_grasps(file, T_hand_tool)
    reach = float(np.linalg.norm(workpiece.extents)) / 2
    for point in points:
        if point.opening is not None and point.opening > gripper.max_opening:
            valid = f"an opening of at most {gripper.max_opening} m, that of {gripper.name}"
            raise InputError(file, f"grasps.{point.name}", point.opening, valid)
        if np.linalg.norm(point.centre) > reach:
            valid = f"a tool centre point on {workpiece.name}, within {reach:.3f} m of its CAD origin (see --tool)"
            raise InputError(file, f"grasps.{point.name}.position", point.centre, valid)
    return points
