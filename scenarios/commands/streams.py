"""Standard output and error that may be closed, full or missing, without ending the work that writes to them."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO, cast


class _Lasting:
    """A text stream that discards its text once its reader is closed."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """The same method of the wrapped stream, without the error of a closed reader."""
        try:
            return self._stream.write(text)
        except BrokenPipeError:
            to_nowhere(self._stream)
            return len(text)

    def flush(self) -> None:
        """The same method of the wrapped stream, without the error of a closed reader."""
        try:
            self._stream.flush()
        except BrokenPipeError:
            to_nowhere(self._stream)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def lasting_streams() -> Iterator[None]:
    """Inside this context a closed reader of stdout or stderr, as in `| head -1`, does not end the program."""
    before = sys.stdout, sys.stderr
    _open_descriptors()
    made = [open(os.devnull, "w") if s is None else s for s in before]  # noqa: PTH123, SIM115
    for stream in made:
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    sys.stdout, sys.stderr = (cast(TextIO, _Lasting(s)) for s in made)
    try:
        yield
    finally:
        sys.stderr.flush()
        sys.stdout, sys.stderr = before


def _open_descriptors() -> None:
    """Open closed descriptors 0 to 2, so that no results file gets descriptor 1, to which libraries write."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)


def to_nowhere(stream: TextIO) -> None:
    """Send the buffered and all further text of a stream to the null device."""
    with suppress(OSError, ValueError):  # a stream in memory has no descriptor
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
