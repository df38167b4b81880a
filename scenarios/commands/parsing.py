"""The parser of every command: one-line errors that name what was likely meant, arguments added when they are needed.

What a command needs is imported when it is parsed: `pickproof --help` must not wait for torch.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NoReturn

from pickproof.cell.errors import did_you_mean

FOLDER = "--workpieces"


class _Folder(argparse.Action):
    """Collects the folders of all parsers of a command line in one list, in their order."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, *_: Any) -> None:
        assert isinstance(parser, Parser)
        parser.folders.append(values)


class Parser(argparse.ArgumentParser):
    """Every parser, at whatever depth, takes --workpieces; no option may be abbreviated.

    Args:
        folders: where --workpieces is collected.
        fill: adds the arguments, called once the command line names the command.
    """

    def __init__(
        self,
        *args: Any,
        folders: list[str] | None = None,
        fill: Callable[[Parser], None] | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__(*args, **{"allow_abbrev": False, **kwargs})
        self.folders: list[str] = [] if folders is None else folders
        self._fill, self._has_commands = fill, False
        self.add_argument(
            FOLDER,
            action=_Folder,
            dest=argparse.SUPPRESS,
            default=argparse.SUPPRESS,
            metavar="DIR",
            help="a folder of your own workpieces, looked up first; may be repeated",
        )

    def add_subparsers(self, **kwargs: Any) -> Any:
        """Commands below this one, parsed by the same class."""
        self._has_commands = True
        return super().add_subparsers(parser_class=partial(Parser, folders=self.folders), **kwargs)  # type: ignore[call-overload]

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """As argparse, the arguments added first."""
        if self._fill is not None:
            fill, self._fill = self._fill, None
            fill(self)
        if args is not None:
            self._refuse_unknown(args)
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Errors as one line, like every other error of the program."""
        self.exit(2, f"pickproof: error: {' '.join(message.split())} (see {self.prog} --help)\n")

    def _refuse_unknown(self, words: Sequence[str]) -> None:
        """argparse would take the word after an unknown option for a command, and blame that one."""
        known = self._option_string_actions
        take = iter(words)
        for word in take:
            option, equals, value = word.partition("=")
            if word == "--":
                return
            if value == "--":  # argparse would hand on an empty list
                self.error(f"argument {option}: '--' is not valid; expected a value")
            if not option.startswith("-") or option == "-":
                if self._has_commands:
                    return  # the rest is the command's
            elif option in known:
                if self._has_commands and not equals and known[option].nargs is None:
                    next(take, None)
            elif self._has_commands or (option.startswith("--") and " " not in word):
                place = "; options of a command follow its name" if self._has_commands else ""
                self.error(f"unknown option {option}{did_you_mean(option, list(known))}{place}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            known = [str(choice) for choice in action.choices]
            message = f"{value!r} is not valid; expected one of: {', '.join(known)}{did_you_mean(str(value), known)}"
            raise argparse.ArgumentError(action, message)
