"""What `pickproof tune` may change of a whole cell: table of grasps, priorities, weights of the rank, and fields."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from pickproof.grasping.grasp_points import GraspPoint
from pickproof.grasping.ranking import GraspingConfig
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.tuning.optimizer import Parameter, Values
from pickproof.scenarios.tuning.scenario_fields import Field, value_of, with_fields

APPROACH = (0.5, 1.5)  # of the approach distance
WEIGHT = 2.0  # of a weight of the rank, at least up to which it may go
PRIORITY, TABLE, APPROACH_FACTOR = "priority ", "table", "approach_factor"


class Cell(NamedTuple):
    """A cell to be tried: grasp points in their order, and the scenario that uses them."""

    points: list[GraspPoint]
    scenario: Scenario


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


def candidate(values: Values, tables: tuple[Sequence[GraspPoint], Sequence[GraspPoint]], scenario: Scenario) -> Cell:
    """The cell that values of `cell_parameters` stand for; `tables` of grasp points as it was, and as tuned."""
    points = [_changed_point(point, values) for point in tables[int(values.get(TABLE, 0))]]
    own = {n: v for n, v in values.items() if n not in (TABLE, APPROACH_FACTOR) and not n.startswith(PRIORITY)}
    data = scenario.model_dump(mode="json")
    return Cell(points, with_fields(scenario, {n: _tidy(v) for n, v in own.items() if v != value_of(data, n)}))


def _changed_point(point: GraspPoint, values: Values) -> GraspPoint:
    """With its priority and approach distance as `values` say, where they are of this point."""
    change: dict[str, Any] = {}
    priority, factor = values.get(PRIORITY + point.name), values.get(APPROACH_FACTOR, 1.0)
    if priority is not None and priority != point.priority:
        change["priority"] = round(priority, 3)
    if priority is not None and factor != 1.0:
        change["approach_distance"] = round(min(point.approach_distance * factor, 0.5), 4)
    return point.model_copy(update=change)


def _tidy(value: float) -> float:
    return float(f"{value:.4g}")
