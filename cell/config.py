"""YAML files read into typed, schema-checked models; every error names file, field, value and what is valid."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.constructor import DuplicateKeyError
from ruamel.yaml.error import YAMLError

from cell.errors import InputError


class Config(BaseModel):
    """Base of every model that a user writes as YAML: frozen, no unknown fields, finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


M = TypeVar("M", bound=Config)


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
    """What a text of YAML 1.2 means: 3e-4 is a number, 10:30 is not, and a field stands once.

    Raises:
        YAMLError: not YAML.
    """
    return YAML(typ="safe", pure=True).load(text)


def parse_yaml(text: str, path: Path) -> dict[str, Any]:
    """The YAML mapping that is the text of a file at `path`.

    Raises:
        InputError: not YAML, or not a mapping.
    """
    try:
        data = yaml_value(text)
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        at = f"line {mark.line + 1}, column {mark.column + 1}" if mark is not None else str(error)
        what = "a field that came before" if isinstance(error, DuplicateKeyError) else "a syntax error"
        raise InputError(path, "", at, f"YAML ({what} stands there)") from None
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
            parent: Any = data
            valid = "one of: " + ", ".join(_fields_at(model, first["loc"][:-1]))
            for part in first["loc"]:
                parent = parent[part]
            raise InputError(file, field, parent, f"no such field; {valid}") from None
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
