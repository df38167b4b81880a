"""The error classes of the project."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path


class PickproofError(Exception):
    """Root of every error that a user's input can cause; the CLI prints it as one line and exits with 2."""


class InputError(PickproofError):
    """A user's input is not valid.

    Attributes:
        file: where the input comes from (a path, or `command line`).
        field: the dotted name of the offending field, or an empty string for the file as a whole.
        value: the value found there.
        valid: the values that are accepted.
    """

    def __init__(self, file: str | Path, field: str, value: object, valid: str) -> None:
        self.file, self.field, self.value, self.valid = str(file), field, value, valid
        shown = repr(value)
        if len(shown) > 120:
            shown = shown[:117] + "..."
        where = f"{self.file}: {field}" if field else self.file
        super().__init__(f"{where}: {shown} is not valid; expected {valid}")


def did_you_mean(value: object, known: Iterable[str]) -> str:
    """A suggestion to append to a message: the known word closest to the wrong one; empty where none is close."""
    from difflib import get_close_matches

    near = get_close_matches(str(value), list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


class SimulationError(PickproofError):
    """The physics produced an invalid state (NaN, an object at infinity, a client that no longer answers)."""
