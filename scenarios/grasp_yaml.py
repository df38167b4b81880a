"""The text of a grasps.yaml changed in place: every line that is not meant stays as it was, comments and order too.

Whole entries are moved, added and removed as lines of text. Fields of an entry are set by ruamel.yaml, whose round trip
keeps comments; of what it writes only the lines that differ are taken over.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from difflib import SequenceMatcher
from typing import Any

import yaml
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import YAMLError
from ruamel.yaml.nodes import ScalarNode
from ruamel.yaml.representer import RoundTripRepresenter

from grasping.grasp_points import GraspPoint

DIGITS = 9  # after the point of what is written


class EditError(Exception):
    """The text cannot be changed by a machine without losing something of it; says why."""


class _Representer(RoundTripRepresenter):
    """Numbers without exponents: YAML 1.1 takes 5e-06 for a string."""


def _number(representer: RoundTripRepresenter, value: float) -> ScalarNode:
    text = f"{value + 0.0:.{DIGITS}f}".rstrip("0")
    node: ScalarNode = representer.represent_scalar("tag:yaml.org,2002:float", text + "0" * text.endswith("."))
    return node


_Representer.add_representer(float, _number)


def check_text(text: str) -> None:
    """Raise EditError where a round trip is not possible, as with a field that is given twice."""
    _load(_yaml(text), text)


def entry_text(point: GraspPoint) -> str:
    """A grasp point as one item of a list in YAML, at no indent; fields that have their default are left out."""
    fields = point.model_dump(mode="json", exclude_defaults=True)
    return str(yaml.safe_dump([fields], sort_keys=False, default_flow_style=None, width=120))


def set_fields(text: str, index: int, changes: Mapping[str, Any]) -> str:
    """The text with fields of the grasp at `index` set to plain values; None takes the field away.

    Raises:
        EditError: see `check_text`.
    """
    round_trip = _yaml(text)
    document = _load(round_trip, text)
    plain = _dump(round_trip, document)
    entry = document["grasps"][index]
    for name, value in changes.items():
        if value is None:
            entry.pop(name, None)
        else:
            entry[name] = _styled(value, entry.get(name))
    return _only_what_differs(text, plain, _dump(round_trip, document))


def rearrange(text: str, order: Sequence[int | GraspPoint]) -> str:
    """The text with its grasps in another order: each an index of those that are there, or a new one.

    What is not named is removed, with the comments right above and beside it.

    Raises:
        EditError: the grasps do not stand on lines of their own.
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
    root: Any = yaml.compose(text, Loader=yaml.SafeLoader)
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
    """A blank line, or a comment that stands no deeper than the dashes."""
    return not line.strip() or len(line) - len(line.lstrip()) <= column


def _last_line(node: Any) -> int:
    """Of the text of a node; the end mark of a block is behind what follows it."""
    if isinstance(node, yaml.ScalarNode) or node.flow_style:
        mark = node.end_mark
        return int(mark.line - (mark.column == 0 and mark.line > node.start_mark.line))
    children = [c for pair in node.value for c in (pair if isinstance(pair, tuple) else (pair,))]
    return max(_last_line(child) for child in children)


def _yaml(text: str) -> YAML:
    """A round trip that writes as the text is written."""
    round_trip = YAML(typ="rt")
    round_trip.Representer = _Representer
    round_trip.preserve_quotes = True
    round_trip.width = 4096
    dash = next((line for line in text.splitlines() if line.lstrip().startswith("- ")), "  - x")
    column = len(dash) - len(dash.lstrip())
    content = len(dash) - len(dash.lstrip()[1:].lstrip())
    round_trip.indent(mapping=2, sequence=max(content, column + 2), offset=column)
    return round_trip


def _load(round_trip: YAML, text: str) -> Any:
    try:
        return round_trip.load(text)
    except YAMLError as error:
        raise EditError(" ".join(str(error).split())) from None


def _dump(round_trip: YAML, document: Any) -> str:
    stream = io.StringIO()
    round_trip.dump(document, stream)
    return stream.getvalue()


def _styled(value: Any, old: Any) -> Any:
    """A plain value as ruamel.yaml writes it: on one line, unless what it replaces was not."""
    if isinstance(value, Mapping):
        mapping = CommentedMap({k: _styled(v, None) for k, v in value.items()})
        mapping.fa.set_flow_style()
        return mapping
    if isinstance(value, (list, tuple)):
        sequence = CommentedSeq([_styled(v, None) for v in value])
        if not (isinstance(old, CommentedSeq) and old.fa.flow_style() is False):
            sequence.fa.set_flow_style()
        return sequence
    return value


def _only_what_differs(text: str, plain: str, changed: str) -> str:
    """`text` with the lines that differ between `plain`, its own round trip, and `changed`.

    A comment that stands on a line of its own is never lost, whatever field goes.
    """
    own, before, after = (t.splitlines(keepends=True) for t in (text, plain, changed))
    if len(own) != len(before):
        return changed  # what the text wraps the round trip does not
    out: list[str] = []
    for kind, a, b, c, d in SequenceMatcher(None, before, after, autojunk=False).get_opcodes():
        if kind == "equal":
            out += own[a:b]
            continue
        here = after[c:d]
        out += [line for line in own[a:b] if line.lstrip().startswith("#") and line not in here] + here
    return "".join(out)
