"""How values of the command line are read, and the options that several commands share.

cyclopts reads the command line. What it cannot say in one line is written here: the range of a number together with
the value that was given, and whether a file can be written before the work that fills it begins.
"""

# no `from __future__ import annotations`: cyclopts evaluates a field inherited from here in the module of the heir
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter, Token

from pickproof.cell.child_process import FOLDERS
from pickproof.cell.errors import InputError
from pickproof.scenarios.config.oracles import Oracle
from pickproof.scenarios.config.seeds import MAX_SEED

Flat = Parameter(name="*")
"""The fields of a dataclass are options of the command."""


def about(text: str, **more: Any) -> Parameter:
    """The line of an option in the help; `more` as cyclopts.Parameter takes it."""
    return Parameter(help=text, **more)


def read_by(parse: Callable[[str], Any], many: bool = False) -> Parameter:
    """Values are read by a function of one word, whose ValueError says what is valid; with `many`, as a tuple."""

    def convert(kind: Any, tokens: Sequence[Token]) -> Any:
        values = tuple(parse(token.value) for token in tokens)
        return values if many else values[0]

    return Parameter(converter=convert)


def parse_integer(low: int, high: int) -> Callable[[str], int]:
    """A parser of integers from `low` to `high`."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise ValueError(f"{text!r} is not valid; expected an integer from {low} to {high}")
        return value

    return parse


def parse_number(low: float, high: float, above: bool = False) -> Callable[[str], float]:
    """A parser of numbers from `low` to `high`, or above `low`; NaN is refused."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (low < value if above else low <= value) or not value <= high:
            words = f"above {low:g} and at most {high:g}" if above else f"from {low:g} to {high:g}"
            raise ValueError(f"{text!r} is not valid; expected a number {words}")
        return value

    return parse


def parse_fraction(text: str) -> float:
    """A number between 0 and 1, both excluded."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1:
        raise ValueError(f"{text!r} is not valid; expected a number between 0 and 1")
    return value


def parse_path(text: str) -> Path:
    """A path; an empty word, as from an unset variable, is refused, since it would mean the current folder."""
    if not text.strip():
        raise ValueError(f"{text!r} is not valid; expected a path")
    return Path(text)


def parse_file_to_write(text: str) -> Path:
    """A path where a file can be written; checked before the work begins."""
    path = parse_path(text)
    if path.is_dir():
        raise ValueError(f"{text!r} is not valid; expected a file, this is a folder")
    _check_room(text, path)
    return path


def parse_folder_to_write(text: str) -> Path:
    """A folder that exists or can be created; checked before the work begins."""
    path = parse_path(text)
    if path.exists() and not path.is_dir():
        raise ValueError(f"{text!r} is not valid; expected a folder, this is a file")
    _check_room(text, path)
    return path


def _check_room(text: str, path: Path) -> None:
    above = next(p for p in (path.absolute(), *path.absolute().parents) if p.exists())
    if above != path.absolute() and not above.is_dir():
        raise ValueError(f"{text!r} is not valid; {above} is a file; expected a folder")
    if not os.access(above, os.W_OK):
        raise ValueError(f"{text!r} is not valid; {above} cannot be written")


def integer(low: int, high: int) -> Parameter:
    """An integer from `low` to `high`."""
    return read_by(parse_integer(low, high))


def number(low: float, high: float, above: bool = False) -> Parameter:
    """A number from `low` to `high`, or `above` low."""
    return read_by(parse_number(low, high, above))


SOME_PATH = read_by(parse_path)
FILE_TO_WRITE = read_by(parse_file_to_write)
FOLDER_TO_WRITE = read_by(parse_folder_to_write)
FRACTION = read_by(parse_fraction)

WorkpieceName = Annotated[str, about("a name that `pickproof list` shows")]
ScenarioName = Annotated[str, about("a name that `pickproof list` shows, or a YAML file")]
ResultsFolder = Annotated[Path, SOME_PATH, about("folder of results of `pickproof run`")]
AttemptIndex = Annotated[str, about("number of the attempt in the report's list")]
Seed = Annotated[int | None, integer(0, MAX_SEED), about("of the first episode; default: the scenario's")]
Workers = Annotated[int, integer(1, 256), about("processes")]
JsonFile = Annotated[Path | None, FILE_TO_WRITE, about("write the figures to this file as JSON")]


@dataclass(frozen=True, kw_only=True)
class ScenarioFields:
    """--set and --oracle."""

    set: Annotated[tuple[str, ...], about("FIELD=VALUE overrides a field, as camera.width=1280")] = ()
    oracle: Annotated[tuple[Oracle, ...], about("replace this stage by ground truth")] = ()


@dataclass(frozen=True, kw_only=True)
class ScenarioChanges(ScenarioFields):
    """--set, --oracle and --workers."""

    workers: Workers = 1


def search_folders(given: Sequence[str], makes_first: bool = False) -> str:
    """The new PICKPROOF_WORKPIECES, from the folders of --workpieces; empty where none is given.

    Args:
        makes_first: the command creates the first of them where it does not exist, as `onboard` does.

    Raises:
        InputError: one does not exist, or is not a folder.
    """
    for i, folder in enumerate(given):
        may_be_new = makes_first and i == 0 and bool(folder) and not Path(folder).exists()
        if not may_be_new and (not folder or not Path(folder).is_dir()):
            raise InputError("command line", "--workpieces", folder, "an existing folder of workpiece folders")
    before = os.environ.get(FOLDERS, "")
    folders = [str(Path(folder).resolve()) for folder in given]
    return os.pathsep.join([*folders, *([before] if before else [])]) if folders else ""
