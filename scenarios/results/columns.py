"""Columns of the results file follow from the fields of a record, with one rule for every field.

| field | column | value in the file |
|---|---|---|
| `int`, `bool` | INTEGER | as it is |
| `float` | REAL | as it is |
| `str`, an enum of words, a literal | TEXT | as it is |
| anything else: matrices, trees | TEXT | as JSON |

`X | None` may be NULL, everything else is NOT NULL. A field with metadata `OWN_TABLE` has no column.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

LARGE = {"large": True}
"""Metadata of a field that is most of a record: it is read where it is asked for."""
OWN_TABLE = {"own_table": True}
"""Metadata of a field that is stored in a table of its own."""

_SQL: dict[type, str] = {bool: "INTEGER", int: "INTEGER", float: "REAL", str: "TEXT"}


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        kind: `bool`, `int`, `float` or `str`; None for what is stored as JSON.
        hint: type of the field without `None`.
        nullable: the field may be None.
        large: see `LARGE`.
    """

    name: str
    kind: type | None
    hint: Any
    nullable: bool
    large: bool

    @property
    def sql(self) -> str:
        """Its definition in a new table."""
        return f"{self.added_sql}{'' if self.nullable else ' NOT NULL'}"

    @property
    def added_sql(self) -> str:
        """Its definition where it is added to an older table: NULL in the rows that are there already."""
        return f"{self.name} {'TEXT' if self.kind is None else _SQL[self.kind]}"

    def to_sql(self, value: Any) -> Any:
        """The value of the field as it is stored."""
        if self.kind is not None or (value is None and self.nullable):
            return value
        return json.dumps(value, default=_plain)

    def from_sql(self, value: Any) -> Any:
        """The value of the field from what is stored; not for NULL."""
        if self.kind is None:
            return _decoded(value)
        return bool(value) if self.kind is bool else value


def columns_of(record: type) -> tuple[Column, ...]:
    """The columns of a record's dataclass, in the order of its fields."""
    return _columns_of(record)


@cache
def _columns_of(record: type) -> tuple[Column, ...]:
    hints = get_type_hints(record)
    return tuple(
        _column(f.name, hints[f.name], bool(f.metadata.get("large")))
        for f in fields(record)
        if not f.metadata.get("own_table")
    )


def _column(name: str, hint: Any, large: bool) -> Column:
    options = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    kept = [option for option in options if option is not NoneType]
    kinds = {_kind(option) for option in kept}
    kind = kinds.pop() if len(kinds) == 1 else None
    return Column(name, kind, kept[0] if len(kept) == 1 else hint, len(kept) < len(options), large)


def _kind(hint: Any) -> type | None:
    if get_origin(hint) is Literal:
        kinds = {_kind(type(value)) for value in get_args(hint)}
        return kinds.pop() if len(kinds) == 1 else None
    # bool before int, of which it is a subclass; a StrEnum is a str
    return next((kind for kind in _SQL if isinstance(hint, type) and issubclass(hint, kind)), None)


def values_of(record: type, row: dict[str, Any]) -> dict[str, Any]:
    """Field -> value from column -> stored value; NULL and what is missing are left out, which gives the default."""
    return {c.name: c.from_sql(row[c.name]) for c in columns_of(record) if row.get(c.name) is not None}


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)


def _decoded(text: str) -> Any:
    try:
        return msgspec.json.decode(text)  # three times as quick, which 500 MB of trees show
    except msgspec.DecodeError:
        return json.loads(text)  # knows NaN and Infinity, which json.dumps writes
