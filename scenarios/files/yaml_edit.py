"""Edits the text of a YAML file in place: all other lines, comments and the order are kept.

Values are set by ruamel.yaml, whose round trip keeps comments; only the lines that differ are taken from its output.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from difflib import SequenceMatcher
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import YAMLError
from ruamel.yaml.nodes import ScalarNode
from ruamel.yaml.representer import RoundTripRepresenter

DIGITS = 9  # after the point of what is written


class EditError(Exception):
    """The text cannot be edited automatically without a loss; the message says why."""


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


def edit_text(text: str, change: Callable[[Any], None]) -> str:
    """The text after `change` was applied to its document: plain mappings and lists, values set by `styled`.

    Raises:
        EditError: see `check_text`.
    """
    round_trip = _yaml(text)
    document = _load(round_trip, text)
    plain = _dump(round_trip, document)
    change(document)
    return _only_what_differs(text, plain, _dump(round_trip, document))


def styled(value: Any, old: Any) -> Any:
    """A plain value as ruamel.yaml writes it: on one line, unless what it replaces was not."""
    if isinstance(value, Mapping):
        mapping = CommentedMap({k: styled(v, None) for k, v in value.items()})
        mapping.fa.set_flow_style()
        return mapping
    if isinstance(value, (list, tuple)):
        sequence = CommentedSeq([styled(v, None) for v in value])
        if not (isinstance(old, CommentedSeq) and old.fa.flow_style() is False):
            sequence.fa.set_flow_style()
        return sequence
    return value


def _yaml(text: str) -> YAML:
    """A round trip with the indentation of the text."""
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


def _only_what_differs(text: str, plain: str, changed: str) -> str:
    """`text` with the lines that differ between `plain`, its own round trip, and `changed`.

    A comment on its own line is never lost, even if its field is removed.
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
