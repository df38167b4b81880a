"""Arguments that several commands share."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from pathlib import Path

from cell.errors import InputError
from cell.processes import FOLDERS

ORACLES = ("perception", "grasp", "motion")
"""Stages that ground truth can replace, in the order of a pick; docs/statistics.md defines each."""
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


def fraction(text: str) -> float:
    """A number between 0 and 1, both excluded."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not valid; expected a number between 0 and 1")
    return value


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


def take_folders(words: Sequence[str]) -> tuple[list[str], str]:
    """The words without every `--workpieces DIR`, and the new PICKPROOF_WORKPIECES; empty where none was given.

    Raises:
        InputError: no folder follows, or it does not exist (`onboard` makes its own).
    """
    option, rest, folders = "--workpieces", [], []
    take = iter(words)
    for word in take:
        name, equals, value = word.partition("=")
        if name != option:
            rest.append(word)
            continue
        folder = value if equals else next(take, "")
        if not folder or (not Path(folder).is_dir() and words[0] != "onboard"):
            raise InputError("command line", option, folder, "an existing folder of workpiece folders")
        folders.append(str(Path(folder).resolve()))
    before = os.environ.get(FOLDERS, "")
    return rest, os.pathsep.join([*folders, *([before] if before else [])]) if folders else ""
