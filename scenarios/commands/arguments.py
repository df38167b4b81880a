"""Arguments that several commands share."""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path

from pickproof.cell.child_process import FOLDERS
from pickproof.cell.errors import InputError
from pickproof.scenarios.config.oracles import ORACLES

MAX_SEED = 2**31 - 1


def integer(low: int, high: int) -> Callable[[str], int]:
    """A parser of integers from `low` to `high`."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not valid; expected an integer from {low} to {high}")
        return value

    return parse


def number(low: float, high: float, above: bool = False) -> Callable[[str], float]:
    """A parser of numbers from `low` to `high`, or `above` low; NaN is none."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (low < value if above else low <= value) or not value <= high:
            words = f"above {low:g} and at most {high:g}" if above else f"from {low:g} to {high:g}"
            raise argparse.ArgumentTypeError(f"{text!r} is not valid; expected a number {words}")
        return value

    return parse


def fraction(text: str) -> float:
    """A number between 0 and 1, both excluded."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not valid; expected a number between 0 and 1")
    return value


def some_path(text: str) -> Path:
    """A path; an empty word, as of a variable that is not set, would be the current folder."""
    if not text.strip():
        raise argparse.ArgumentTypeError(f"{text!r} is not valid; expected a path")
    return Path(text)


def file_to_write(text: str) -> Path:
    """Where a file can be written, which is found out before the work that fills it."""
    path = some_path(text)
    if path.is_dir():
        raise argparse.ArgumentTypeError(f"{text!r} is not valid; expected a file, this is a folder")
    _check_room(text, path)
    return path


def folder_to_write(text: str) -> Path:
    """A folder that exists or can be made, which is found out before the work that fills it."""
    path = some_path(text)
    if path.exists() and not path.is_dir():
        raise argparse.ArgumentTypeError(f"{text!r} is not valid; expected a folder, this is a file")
    _check_room(text, path)
    return path


def _check_room(text: str, path: Path) -> None:
    above = next(p for p in (path.absolute(), *path.absolute().parents) if p.exists())
    if above != path.absolute() and not above.is_dir():
        raise argparse.ArgumentTypeError(f"{text!r} is not valid; {above} is a file, and holds nothing")
    if not os.access(above, os.W_OK):
        raise argparse.ArgumentTypeError(f"{text!r} is not valid; {above} cannot be written")


def add_scenario_arguments(parser: argparse.ArgumentParser) -> None:
    """SCENARIO, --set, --oracle and --workers."""
    parser.add_argument("scenario", metavar="SCENARIO", help="a name that `pickproof list` shows, or a YAML file")
    add_change_arguments(parser)


def add_change_arguments(parser: argparse.ArgumentParser) -> None:
    """--set, --oracle and --workers."""
    parser.add_argument(
        "--set", action="append", default=[], metavar="FIELD=VALUE", help="override a field, as camera.width=1280"
    )
    parser.add_argument(
        "--oracle", choices=ORACLES, action="append", default=[], help="replace this stage by ground truth"
    )
    parser.add_argument("--workers", type=integer(1, 256), default=1, metavar="K", help="processes (default 1)")


def search_folders(given: Sequence[str], makes_first: bool = False) -> str:
    """The new PICKPROOF_WORKPIECES, from the folders that --workpieces names; empty where none was given.

    Args:
        makes_first: the command creates the first of them where it does not exist, as `onboard` does.

    Raises:
        InputError: one does not exist, or is no folder.
    """
    for i, folder in enumerate(given):
        may_be_new = makes_first and i == 0 and bool(folder) and not Path(folder).exists()
        if not may_be_new and (not folder or not Path(folder).is_dir()):
            raise InputError("command line", "--workpieces", folder, "an existing folder of workpiece folders")
    before = os.environ.get(FOLDERS, "")
    folders = [str(Path(folder).resolve()) for folder in given]
    return os.pathsep.join([*folders, *([before] if before else [])]) if folders else ""
