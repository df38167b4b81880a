"""YAML files read into typed, schema-checked models; every error names file, field, value and what is valid."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import PydanticCustomError
from ruamel.yaml import YAML
from ruamel.yaml.constructor import DuplicateKeyError
from ruamel.yaml.error import YAMLError
from ruamel.yaml.nodes import ScalarNode
from ruamel.yaml.representer import SafeRepresenter

from pickproof.cell.errors import InputError


class Config(BaseModel):
    """Base of every model that a user writes as YAML: frozen, no unknown fields, finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


M = TypeVar("M", bound=Config)


def metres(most: float) -> AfterValidator:
    """For `Annotated`: a length in [m] of at most `most` in magnitude; a larger value is probably given in mm."""

    def check(value: float) -> float:
        if abs(value) > most:
            raise PydanticCustomError("length", "at most {most} m; in m, is it in mm?", {"most": f"{most:g}"})
        return value

    return AfterValidator(check)


def _radians(value: float) -> float:
    if abs(value) > 2 * math.pi:
        raise PydanticCustomError("angle", "at most 2 pi, 6.2832 rad; in rad, is it in degrees?")
    return value


Coordinate = Annotated[float, metres(10.0)]
"""[m] of a place in a cell."""
Length = Annotated[float, Field(gt=0), metres(5.0)]
"""[m] of a bin or a workpiece."""
Offset = Annotated[float, metres(2.0)]
"""[m] in the frame of a workpiece or a gripper."""
Small = Annotated[float, Field(gt=0), metres(0.5)]
"""[m] of a feature of a workpiece or a gripper."""
Fine = Annotated[float, Field(ge=0), metres(0.1)]
"""[m] of a tolerance or an error."""
Sigma = Annotated[float, Field(ge=0), metres(0.01)]
"""[m] of a camera's noise."""
Angle = Annotated[float, AfterValidator(_radians)]
"""[rad]"""
Point = tuple[Coordinate, Coordinate, Coordinate]
Size = tuple[Length, Length, Length]
OffsetPoint = tuple[Offset, Offset, Offset]
Angles = tuple[Angle, Angle, Angle]


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML mapping.

    Raises:
        InputError: the file is missing, unreadable, not YAML, or not a mapping.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(path, "", "missing file", "an existing YAML file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, "", str(error), "a readable UTF-8 YAML file") from None
    return parse_yaml(text, path)


def yaml_value(text: str) -> Any:
    """Parse a YAML 1.2 text: 3e-4 is a number, 10:30 is not, and a repeated field is an error.

    Raises:
        YAMLError: not YAML.
    """
    try:
        return YAML(typ="safe", pure=True).load(text)
    except (YAMLError, RecursionError):
        raise
    except Exception as error:  # noqa: BLE001  constructors of dates, numbers and keys raise whatever theirs raise
        raise YAMLError(f"{type(error).__name__}: {error}") from None


class _Representer(SafeRepresenter):
    """Writes numbers as 1.0e-05, because YAML 1.1 readers take 1e-05 for a string."""

    def represent_float(self, data: float) -> ScalarNode:
        """Represent a float as ruamel does, always with a decimal point."""
        node: ScalarNode = super().represent_float(data)
        if "e" in node.value and "." not in node.value:
            node.value = node.value.replace("e", ".0e")
        return node


_Representer.add_representer(float, _Representer.represent_float)


def yaml_text(data: Any) -> str:
    """Plain data as YAML text, fields in their order; a list or mapping that is not nested takes one line."""
    writer = YAML(typ="safe", pure=True)
    writer.Representer = _Representer
    writer.default_flow_style = None
    writer.width = 120
    writer.sort_base_mapping_type_on_output = False  # type: ignore[assignment]  # declared as None
    stream = io.StringIO()
    writer.dump(data, stream)
    return stream.getvalue()


def parse_yaml(text: str, path: Path) -> dict[str, Any]:
    """Parse the text of the file at `path` as a YAML mapping.

    Raises:
        InputError: not YAML, or not a mapping.
    """
    try:
        data = yaml_value(text)
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        at = f"line {mark.line + 1}, column {mark.column + 1}" if mark is not None else str(error)
        valid = "each field once" if isinstance(error, DuplicateKeyError) else "valid YAML; correct the syntax there"
        raise InputError(path, "", at, valid) from None
    except RecursionError:
        raise InputError(path, "", "lists or mappings nested too deeply", "YAML of some levels") from None
    if not isinstance(data, dict):
        raise InputError(path, "", type(data).__name__, "a YAML mapping of fields to values")
    return data


def parse(model: type[M], data: Any, file: str | Path) -> M:
    """Check `data` against `model`; the first violation becomes an InputError."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            valid = "one of: " + ", ".join(_fields_at(model, first["loc"][:-1]))
            raise InputError(file, field, first["input"], f"no such field; {valid}") from None
        if first["type"] == "missing":
            raise InputError(file, field, "nothing", "a value; the field has no default") from None
        raise InputError(file, field, first["input"], first["msg"].removeprefix("Input should be ")) from None


def load(model: type[M], path: Path) -> M:
    """Read and check a YAML file."""
    return parse(model, read_yaml(path), path)


def _fields_at(model: type[BaseModel], loc: tuple[Any, ...]) -> list[str]:
    for part in loc:
        field = model.model_fields.get(str(part))
        if field is None or not (isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)):
            return ["the fields in the documentation"]
        model = field.annotation
    return list(model.model_fields)
