"""What `pickproof tune` may change: grasp points, priorities, weights of the rank, and any number of the scenario."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pickproof.cell.config import parse
from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.grasping.grasp_points import GraspPoint, opening
from pickproof.grasping.ranking import GraspingConfig
from pickproof.scenarios.comparison.paired import BIN_FIELDS
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.tuning.optimizer import Parameter, Values

SHIFTS = ("x_mm", "y_mm", "z_mm")
TURNS = ("closing_deg", "across_deg", "approach_deg")  # about x, y and z of the tool
WIDEST = 0.03  # [m] of opening beyond the width
DEPTH_MM = 4.0
APPROACH = (0.5, 1.5)  # of the approach distance
WEIGHT = 2.0  # of a weight of the rank, at least up to which it may go
FIXED_FIELDS = (*BIN_FIELDS, "seed", "stop")


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


@dataclass(frozen=True)
class Field:
    """A number of the scenario and the range that it may be chosen from."""

    name: str
    low: float
    high: float
    start: float
    integer: bool

    @property
    def parameter(self) -> Parameter:
        """The field as a parameter of the search."""
        return Parameter(self.name, self.low, self.high, self.start, self.integer)


def parse_field(text: str, scenario: Scenario) -> Field | None:
    """`FIELD=LOW:HIGH`, or None for a plain override; an element of a list by its index, as `camera.eye.2`.

    Raises:
        InputError: no such number, no range, an end that the schema refuses, or a field that decides how a bin fills.
    """
    name, _, values = text.partition("=")
    if ":" not in values or values.lstrip().startswith(("{", "[")):
        return None
    low, high = _ends(text, values)
    if name.partition(".")[0] in FIXED_FIELDS:
        valid = f"a field that leaves bins and stop rules as they are, so not {', '.join(FIXED_FIELDS)}"
        raise InputError("command line", "--set", name, valid)
    now = _value(scenario.model_dump(mode="json"), name)
    if isinstance(now, bool) or not isinstance(now, int | float):
        raise InputError("command line", "--set", name, "a field of the scenario that is a number")
    if isinstance(now, int) and not (low.is_integer() and high.is_integer()):
        raise InputError("command line", "--set", text, f"whole numbers; {name} is one")
    for end in (low, high):
        with_fields(scenario, {name: round(end) if isinstance(now, int) else end})
    return Field(name, low, high, min(max(float(now), low), high), isinstance(now, int))


def _ends(text: str, values: str) -> tuple[float, float]:
    try:
        low, high = (float(v) for v in values.split(":"))
    except ValueError:
        low = high = 0.0
    if not (low < high and np.isfinite([low, high]).all()):
        raise InputError("command line", "--set", text, "FIELD=LOW:HIGH with two numbers, the first one the smaller")
    return low, high


def with_fields(scenario: Scenario, fields: Values) -> Scenario:
    """The scenario with some of its numbers replaced.

    Raises:
        InputError: the schema refuses a value.
    """
    data = scenario.model_dump(mode="json")
    for name, value in fields.items():
        *path, last = name.split(".")
        inner = _value(data, ".".join(path)) if path else data
        inner[_key(inner, last)] = int(value) if isinstance(_value(data, name), int) else value
    return parse(Scenario, data, f"command line, --set {' '.join(fields)}")


def _value(data: Any, name: str) -> Any:
    for key in name.split("."):
        try:
            data = data[_key(data, key)]
        except (KeyError, IndexError, TypeError):
            raise InputError("command line", "--set", name, "a field of the scenario that is a number") from None
    return data


def _key(data: Any, key: str) -> Any:
    return int(key) if isinstance(data, list) and key.isdigit() else key


PRIORITY, TABLE, APPROACH_FACTOR = "priority ", "table", "approach_factor"


def cell_parameters(
    points: Sequence[GraspPoint], scenario: Scenario, fields: Sequence[Field], choose_table: bool
) -> list[Parameter]:
    """What campaigns decide: the table (0 as it was, 1 moved), priorities, approach, weights, and the fields given."""
    taken = {f.name for f in fields}
    found = [Parameter(TABLE, 0, 1, 0, integer=True)] if choose_table else []
    if points:
        found.append(Parameter(APPROACH_FACTOR, *APPROACH, 1.0))
        found += [Parameter(PRIORITY + p.name, 0.0, 1.0, p.priority) for p in points]
        for name in GraspingConfig.model_fields:
            if name.startswith("weight_") and f"grasping.{name}" not in taken:
                now = float(getattr(scenario.grasping, name))
                found.append(Parameter(f"grasping.{name}", 0.0, max(2 * now, WEIGHT), now))
    return found + [f.parameter for f in fields]


def candidate(
    values: Values, tables: tuple[Sequence[GraspPoint], Sequence[GraspPoint]], scenario: Scenario
) -> tuple[list[GraspPoint], Scenario]:
    """The grasp points and the scenario that values of `cell_parameters` stand for; `tables` as it was, and moved."""
    factor = values.get(APPROACH_FACTOR, 1.0)
    points = []
    for point in tables[int(values.get(TABLE, 0))]:
        change: dict[str, Any] = {}
        priority = values.get(PRIORITY + point.name)
        if priority is not None and priority != point.priority:
            change["priority"] = round(priority, 3)
        if priority is not None and factor != 1.0:
            change["approach_distance"] = round(min(point.approach_distance * factor, 0.5), 4)
        points.append(point.model_copy(update=change))
    own = {n: v for n, v in values.items() if n not in (TABLE, APPROACH_FACTOR) and not n.startswith(PRIORITY)}
    data = scenario.model_dump(mode="json")
    return points, with_fields(scenario, {n: _tidy(v) for n, v in own.items() if v != _value(data, n)})


def _tidy(value: float) -> float:
    return float(f"{value:.4g}")
