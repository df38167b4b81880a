"""The text of a grasps.yaml changed in place: whole entries are moved, added and removed as lines of text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.nodes import ScalarNode

from pickproof.cell.config import yaml_text
from pickproof.grasping.grasp_points import GraspPoint
from pickproof.scenarios.files.yaml_edit import EditError, edit_text, styled


def entry_text(point: GraspPoint) -> str:
    """A grasp point as one item of a list in YAML, at no indent; fields that have their default are left out."""
    fields = point.model_dump(mode="json", exclude_defaults=True)
    return yaml_text([fields])


def set_fields(text: str, index: int, changes: Mapping[str, Any]) -> str:
    """The text with fields of the grasp at `index` set to plain values; None removes a field.

    Raises:
        EditError: see `check_text`.
    """

    def change(document: Any) -> None:
        entry = document["grasps"][index]
        for name, value in changes.items():
            if value is None:
                entry.pop(name, None)
            else:
                entry[name] = styled(value, entry.get(name))

    return edit_text(text, change)


def rearrange(text: str, order: Sequence[int | GraspPoint]) -> str:
    """The text with its grasps in another order: each is the index of an existing grasp, or a new one.

    Grasps that are not named are removed, with the comments directly above and beside them.

    Raises:
        EditError: the grasps are not on separate lines.
    """
    lines = text.splitlines(keepends=True)
    starts, end, column = _blocks(text, lines)
    if lines and not lines[-1].endswith("\n"):
        lines[-1] += "\n"
    ends = [*starts[1:], end]
    blocks = [lines[a:b] for a, b in zip(starts, ends, strict=True)]
    out = lines[: starts[0]]
    for item in order:
        if isinstance(item, int):
            out += blocks[item]
        else:
            out += [" " * column + line for line in entry_text(item).splitlines(keepends=True)]
    return "".join(out + lines[end:])


def _blocks(text: str, lines: Sequence[str]) -> tuple[list[int], int, int]:
    """First line of every entry with the comments over it, the line after the last one, the column of the dashes."""
    root: Any = YAML(typ="safe", pure=True).compose(text)
    head, items = next(pair for pair in root.value if pair[0].value == "grasps")
    dashes = []
    for item in items.value:
        line = item.start_mark.line
        while line >= 0 and not lines[line].lstrip().startswith("-"):
            line -= 1
        dashes.append(line)
    alone = len(set(dashes)) == len(dashes) and dashes[0] > 0 and min(dashes) > items.start_mark.line - 1
    if items.flow_style or not alone:
        raise EditError("the grasps do not each begin on a line of their own with a dash")
    column = len(lines[dashes[0]]) - len(lines[dashes[0]].lstrip())
    after = [_last_line(item) + 1 for item in items.value]
    starts = []
    for k, dash in enumerate(dashes):
        line, top = dash, after[k - 1] if k else head.start_mark.line + 1
        while line > top and _belongs_below(lines[line - 1], column):
            line -= 1
        starts.append(line)
    end = after[-1]
    while end < len(lines) and lines[end].strip() and len(lines[end]) - len(lines[end].lstrip()) > column:
        end += 1  # comments within the last entry
    return starts, end, column


def _belongs_below(line: str, column: int) -> bool:
    """A blank line, or a comment indented no deeper than the dashes."""
    return not line.strip() or len(line) - len(line.lstrip()) <= column


def _last_line(node: Any) -> int:
    """Of the text of a node; the end mark of a block is behind what follows it."""
    if isinstance(node, ScalarNode) or node.flow_style:
        mark = node.end_mark
        return int(mark.line - (mark.column == 0 and mark.line > node.start_mark.line))
    children = [c for pair in node.value for c in (pair if isinstance(pair, tuple) else (pair,))]
    return max(_last_line(child) for child in children)
