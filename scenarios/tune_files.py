"""What `pickproof tune` proposes as YAML: the user's own files with some numbers changed, every comment kept."""

from __future__ import annotations

import json
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedSeq

from cell.errors import InputError
from grasping.grasp_points import GraspPoint
from scenarios.files import write_whole
from scenarios.tune_search import Values

TABLE, SCENARIO = "grasps.yaml", "scenario.yaml"


def changed_table(source: Path, before: Sequence[GraspPoint], after: Sequence[GraspPoint]) -> str:
    """The text of the table at `source` with the fields of grasp points that differ."""
    yaml, data = _read(source)
    entries = {entry["name"]: entry for entry in data["grasps"]}
    for old, new in zip(before, after, strict=True):
        for name, value in new.model_dump(mode="json").items():
            if value == old.model_dump(mode="json")[name]:
                continue
            if value is None:
                entries[new.name].pop(name, None)
            else:
                _put(entries[new.name], name, value)
    return _text(yaml, data)


def changed_scenario(source: Path, fields: dict[str, Any], grasps: str | None) -> str:
    """The text of the scenario at `source` with dotted fields replaced, and naming another table where given."""
    yaml, data = _read(source)
    for dotted, value in fields.items():
        *path, last = dotted.split(".")
        inner = data
        for key in path:
            inner = inner[int(key)] if isinstance(inner, list) else inner.setdefault(key, {})
        _put(inner, int(last) if isinstance(inner, list) else last, value)
    if grasps is not None:
        _put(data, "grasps", grasps)
    return _text(yaml, data)


def accept(folder: Path, table: Path, scenario: Path, fields: Values) -> list[Path]:
    """Write what `folder` proposes over the table and the scenario; those that it changes.

    Raises:
        InputError: the search in `folder` has not ended.
    """
    proposed = folder / TABLE
    if not proposed.is_file():
        raise InputError(folder, TABLE, "missing file", "a folder in which `pickproof tune` has ended")
    written = []
    text = proposed.read_text(encoding="utf-8")
    if text != _text(*_read(table)):
        written.append(write_whole(table, text))
    if fields:
        written.append(write_whole(scenario, changed_scenario(scenario, fields, None)))
    return written


def read_proposal(path: Path) -> dict[str, Any]:
    """A JSON file that `pickproof tune` wrote.

    Raises:
        InputError: it is missing, or no such file.
    """
    try:
        data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(path, "", "missing file", "a folder with a search of `pickproof tune`") from None
    except (OSError, ValueError) as error:
        raise InputError(path, "", str(error), "a JSON file that `pickproof tune` wrote") from None
    return data


def _read(path: Path) -> tuple[YAML, Any]:
    """The document, and what writes it as it was written: lists of entries indented or not."""
    text = path.read_text(encoding="utf-8")
    yaml = YAML()
    yaml.preserve_quotes = True
    yaml.width = 120
    if "\n- " not in text:
        yaml.indent(mapping=2, sequence=4, offset=2)
    return yaml, yaml.load(text)


def _text(yaml: YAML, data: Any) -> str:
    stream = StringIO()
    yaml.dump(data, stream)
    return stream.getvalue()


def _put(data: Any, key: Any, value: Any) -> None:
    """Set an entry; a list that was there keeps its style and its comments."""
    before = data[key] if isinstance(data, list) or key in data else None
    if isinstance(value, list):
        if isinstance(before, list) and len(before) == len(value):
            for i, x in enumerate(value):
                before[i] = x
            return
        value = CommentedSeq(value)
        value.fa.set_flow_style()
    data[key] = value
