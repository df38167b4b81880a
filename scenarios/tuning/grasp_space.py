"""What `pickproof tune` may change of one grasp point: its centre, its axes, its depth and the opening of the jaws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pickproof.cell.frames import Array
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.grasping.grasp_points import GraspPoint, opening
from pickproof.scenarios.tuning.optimizer import Parameter, Values

SHIFTS = ("x_mm", "y_mm", "z_mm")
TURNS = ("closing_deg", "across_deg", "approach_deg")  # about x, y and z of the tool
WIDEST = 0.03  # [m] of opening beyond the width
DEPTH_MM = 4.0


@dataclass(frozen=True)
class Reach:
    """How far a grasp point may be moved: its centre along each axis of the CAD [m], the tool about its axes [deg]."""

    shift: float = 0.008
    turn_deg: float = 15.0


def grasp_parameters(point: GraspPoint, gripper: Gripper, reach: Reach) -> list[Parameter]:
    """What the search may change of one grasp point on a lone workpiece; all but the opening are moves from it."""
    shift = 1000 * reach.shift
    found = [Parameter(name, -shift, shift, 0.0, star=True) for name in SHIFTS if shift]
    found += [Parameter(name, -reach.turn_deg, reach.turn_deg, 0.0) for name in TURNS if reach.turn_deg]
    found.append(Parameter("depth_mm", -DEPTH_MM, DEPTH_MM, 0.0, star=True))
    if isinstance(gripper, ParallelJaw):
        widest = min(gripper.max_opening, point.width + WIDEST)
        start = min(max(opening(point), point.width), widest)
        if widest > point.width:
            found.append(Parameter("opening_mm", 1000 * point.width, 1000 * widest, 1000 * start, star=True))
    return found


def moved(point: GraspPoint, values: Values) -> GraspPoint:
    """The grasp point with `values` of its parameters; what they leave as it is keeps its exact numbers."""
    change: dict[str, Any] = {}
    shift = np.array([values.get(name, 0.0) for name in SHIFTS])
    if shift.any():
        change["centre"] = _rounded(np.asarray(point.centre) + 1e-3 * shift, 5)
    turn = np.deg2rad([values.get(name, 0.0) for name in TURNS])
    if turn.any():
        R = grip_axes(point) @ Rotation.from_rotvec(turn).as_matrix()
        change |= {"approach": _rounded(R[:, 2], 6), "closing": _rounded(R[:, 0], 6)}
    if values["depth_mm"]:
        change["depths"] = tuple(round(d + 1e-3 * values["depth_mm"], 5) for d in point.depths)
    wide = values.get("opening_mm")
    if wide is not None and abs(wide - 1000 * opening(point)) > 1e-6:
        change |= {"opening": max(round(1e-3 * wide, 5), point.width), "stroke": None}
    return GraspPoint.model_validate(point.model_dump() | change)


def distance(parameters: Sequence[Parameter], values: Values) -> float:
    """How far from the start, 0 to about 1: root mean square over the parameters, each by its range."""
    parts = [(values[p.name] - p.start) / max(p.high - p.start, p.start - p.low) for p in parameters]
    return float(np.sqrt(np.mean(np.square(parts))))


def grip_axes(point: GraspPoint) -> Array:
    """R_part_tool (3, 3) of a grasp point: closing, across, approach."""
    z = np.asarray(point.approach) / np.linalg.norm(point.approach)
    x = np.asarray(point.closing) / np.linalg.norm(point.closing)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _rounded(vector: Array, digits: int) -> tuple[float, float, float]:
    x, y, z = (round(float(v), digits) + 0.0 for v in vector)
    return (x, y, z)
