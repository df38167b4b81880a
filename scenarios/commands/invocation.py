"""The words of the running command line, for the field `command` of results and records."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

_words: ContextVar[tuple[str, ...]] = ContextVar("words", default=())


@contextmanager
def invoked_with(words: Sequence[str]) -> Iterator[None]:
    """Inside this context `command_line` returns these words."""
    token = _words.set(tuple(words))
    try:
        yield
    finally:
        _words.reset(token)


def command_line() -> str:
    """The command line in shell syntax, with `pickproof` as the program."""
    return f"pickproof {shlex.join(_words.get())}"
