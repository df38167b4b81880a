"""The words of the command line that runs, for the `command` that results and records hold."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

_words: ContextVar[tuple[str, ...]] = ContextVar("words", default=())


@contextmanager
def invoked_with(words: Sequence[str]) -> Iterator[None]:
    """Meanwhile `command_line` tells these words."""
    token = _words.set(tuple(words))
    try:
        yield
    finally:
        _words.reset(token)


def command_line() -> str:
    """The command line as a shell takes it, with `pickproof` as the program."""
    return f"pickproof {shlex.join(_words.get())}"
