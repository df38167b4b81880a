"""Writes the field tables of docs/reference/ from the schemas: `python docs/fields.py` (`--check` only compares).

A page asks for a table by two comments; what stands between them is replaced:

    <!-- fields: pickproof.scenarios.config.scenario.BinConfig -->
    <!-- end -->
"""

from __future__ import annotations

import re
import sys
import types
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

REFERENCE = Path(__file__).resolve().parent / "reference"
BLOCK = re.compile(r"(<!-- fields: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
SIGNS = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}
PLAIN = {float: "number", int: "integer", str: "text", bool: "true or false", type(None): "null"}


def table(model: type[BaseModel]) -> str:
    """The Markdown table of a model's fields: name, type and limits, default, meaning."""
    rows = [
        f"| `{name}` | {_kind(field)} | {_default(field)} | {_cell(_meaning(field))} |"
        for name, field in model.model_fields.items()
    ]
    return "\n".join(["| field | type and limits | default | meaning |", "|---|---|---|---|", *rows])


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def _kind(field: FieldInfo) -> str:
    found = {key: getattr(m, key) for m in field.metadata for key in SIGNS if hasattr(m, key)}
    if "gt" in found:  # the stricter of two lower limits
        found.pop("ge", None)
    limits = [f"{SIGNS[key]} {value:g}" for key, value in found.items()]
    limits += [f"at least {m.min_length} entries" for m in field.metadata if hasattr(m, "min_length") and _many(field)]
    return _cell(", ".join([_type(field.annotation), *limits]))


def _meaning(field: FieldInfo) -> str:
    kind = field.annotation
    if field.description or not (isinstance(kind, type) and issubclass(kind, BaseModel)):
        return field.description or ""
    return (kind.__doc__ or "").split(". ")[0].split("; ")[0].strip().rstrip(".")  # of the model's docstring


def _many(field: FieldInfo) -> bool:
    return get_origin(field.annotation) in (list, tuple)


def _type(kind: Any) -> str:
    origin, args = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _type(args[0])
    if origin is Literal:
        return " or ".join(f"`{a}`" for a in args)
    if origin in (Union, types.UnionType):
        return " or ".join(_type(a) for a in args)
    if origin is list or (origin is tuple and args[-1] is Ellipsis):
        return f"list of {_type(args[0])}"
    if origin is tuple:
        return f"[{', '.join(map(_type, args))}]" if len(set(args)) > 1 else f"{len(args)} x {_type(args[0])}"
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return f"fields of `{kind.__name__}`"
    return PLAIN.get(kind, "text")


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True, validated_data={})
    if isinstance(value, BaseModel):
        return "see its table"
    if isinstance(value, tuple):
        return f"`{list(value)}`"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return "" if value is None or value == "" else f"`{value:.6g}`" if isinstance(value, float) else f"`{value}`"


def filled(text: str) -> str:
    """A page with all of its tables written anew."""

    def fill(block: re.Match[str]) -> str:
        module, _, name = block[2].rpartition(".")
        return f"{block[1]}{table(getattr(import_module(module), name))}\n{block[3]}"

    return BLOCK.sub(fill, text)


def stale() -> list[Path]:
    """Pages whose tables are not what the schemas say."""
    return [path for path in sorted(REFERENCE.glob("*.md")) if filled(path.read_text()) != path.read_text()]


def main() -> int:
    """Write the tables, or with --check say which pages are out of date."""
    pages = stale()
    if "--check" in sys.argv[1:]:
        print("\n".join(f"{path.name}: out of date; run python docs/fields.py" for path in pages))
        return int(bool(pages))
    for path in pages:
        path.write_text(filled(path.read_text()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
