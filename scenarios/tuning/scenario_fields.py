"""Numbers of the scenario that `pickproof tune` may change, as `--set FIELD=LOW:HIGH` names them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pickproof.cell.config import parse
from pickproof.cell.errors import InputError
from pickproof.scenarios.comparison.paired import BIN_FIELDS
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.tuning.optimizer import Parameter, Values

FIXED_FIELDS = (*BIN_FIELDS, "seed", "stop")


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
    now = value_of(scenario.model_dump(mode="json"), name)
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
        inner = value_of(data, ".".join(path)) if path else data
        inner[_key(inner, last)] = int(value) if isinstance(value_of(data, name), int) else value
    return parse(Scenario, data, f"command line, --set {' '.join(fields)}")


def value_of(data: Any, name: str) -> Any:
    """Of a dotted field in a scenario as JSON; InputError where there is none."""
    for key in name.split("."):
        try:
            data = data[_key(data, key)]
        except (KeyError, IndexError, TypeError):
            raise InputError("command line", "--set", name, "a field of the scenario that is a number") from None
    return data


def _key(data: Any, key: str) -> Any:
    return int(key) if isinstance(data, list) and key.isdigit() else key
