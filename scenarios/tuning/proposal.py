"""What `pickproof tune` proposes as YAML: the user's own files with some numbers changed, every comment kept."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pickproof.cell.config import parse, parse_yaml
from pickproof.cell.errors import InputError
from pickproof.grasping.grasp_points import GraspPoint
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.files.atomic import write_whole
from pickproof.scenarios.files.grasps_yaml import set_fields
from pickproof.scenarios.files.yaml_edit import EditError, check_text, edit_text, styled

T = TypeVar("T")
TABLE, SCENARIO = "grasps.yaml", "scenario.yaml"


def changed_table(
    source: Path, before: Sequence[GraspPoint], after: Sequence[GraspPoint], text: str | None = None
) -> str:
    """The text of the table at `source`, which holds `before`, with the fields of grasp points that differ.

    Args:
        text: that the table had when `before` was read, None for what it has now.

    Raises:
        InputError: the file cannot be changed without losing something of it.
    """
    text = source.read_text(encoding="utf-8") if text is None else text
    for index, (old, new) in enumerate(zip(before, after, strict=True)):
        was, now = old.model_dump(mode="json"), new.model_dump(mode="json")
        if changes := {name: value for name, value in now.items() if value != was[name]}:
            text = _edited(source, partial(set_fields, text, index, changes))
    return text


def changed_scenario(source: Path, fields: dict[str, Any], grasps: str | None, text: str | None = None) -> str:
    """The text of the scenario at `source` with dotted fields replaced, and naming another table where given.

    A list, or the kind of a section, that the file leaves to its default is written out where a field of it changes.

    Args:
        text: of the scenario when `fields` were found, None for what it is now.

    Raises:
        InputError: as `changed_table`.
    """
    changes = fields if grasps is None else fields | {"grasps": grasps}
    text = source.read_text(encoding="utf-8") if text is None else text
    whole = parse(Scenario, parse_yaml(text, source), source).model_dump(mode="json")

    def change(document: Any) -> None:
        for dotted, value in changes.items():
            *path, last = dotted.split(".")
            inner, full = document, whole
            for key in path:
                full = full[int(key)] if isinstance(full, list) else full[key]
                if isinstance(inner, list):
                    inner = inner[int(key)]
                    continue
                if inner.get(key) is None:
                    left_out = full if isinstance(full, list) else {k: v for k, v in full.items() if k == "kind"}
                    inner[key] = styled(left_out, None) if isinstance(full, list) else left_out
                inner = inner[key]
            if isinstance(inner, list):
                inner[int(last)] = value
            else:
                inner[last] = styled(value, inner.get(last))

    return _edited(source, partial(edit_text, text, change))


def check_editable(source: Path) -> None:
    """Raise InputError where the YAML file at `source` cannot be changed by a machine."""
    _edited(source, partial(check_text, source.read_text(encoding="utf-8")))


def accept(folder: Path, table: Path, scenario: Path, fields: dict[str, Any]) -> list[Path]:
    """Write what `folder` proposes over the table and the scenario; those that it changes.

    Raises:
        InputError: the search in `folder` has not ended.
    """
    proposed = folder / TABLE
    if not proposed.is_file():
        raise InputError(folder, TABLE, "missing file", "a folder in which `pickproof tune` has ended")
    written = []
    text = proposed.read_text(encoding="utf-8")
    if text != table.read_text(encoding="utf-8"):
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


def _edited(source: Path, edit: Callable[[], T]) -> T:
    try:
        return edit()
    except EditError as error:
        raise InputError(source, "", str(error), "YAML that a round trip through ruamel.yaml keeps") from None
