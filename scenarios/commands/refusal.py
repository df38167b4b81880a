"""The error of a command line, in one line that names argument, value and valid values.

cyclopts' own texts are not used: they leave out the valid values, some take several lines, and that for an unknown
command imports every command to list them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Literal, get_args, get_origin

from cyclopts import App, CycloptsError
from cyclopts.argument import Argument
from cyclopts.exceptions import (
    CoercionError,
    MissingArgumentError,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
    ValidationError,
)

from pickproof.cell.errors import did_you_mean


def refusal(error: CycloptsError) -> str:
    """One line without the name of the program."""
    chain = " ".join(["pickproof", *(error.command_chain or ())])
    return f"{' '.join(_what(error).split())} (see {chain} --help)"


def no_command(app: App) -> str:
    """The message for a command line without a command."""
    return f"argument COMMAND is missing; expected one of: {', '.join(commands_of(app))}"


def commands_of(app: App) -> list[str]:
    """Names of the commands below an app, none of them imported."""
    return [name for name in app if not name.startswith("-")]


def _what(error: CycloptsError) -> str:
    match error:
        case CoercionError():
            return _wrong_value(error)
        case MissingArgumentError(argument=Argument() as argument):
            count = max(argument.token_count()[0], 1)
            expected = "one argument" if count == 1 else f"{count} arguments"
            return f"argument {error.keyword or argument.name}: too few words; expected {expected}"
        case UnknownOptionError():
            names = [name for argument in error.argument_collection for name in argument.names]
            return _unknown_option(error.token.keyword or error.token.value, names)
        case UnknownCommandError(unused_tokens=[word, *_]):
            return _unknown_command(word, error.app)
        case ValidationError() if "Mutually exclusive" in str(error):
            first, *others = re.findall(r"--[\w-]+", str(error))
            return f"argument {', '.join(others)}: not allowed with argument {first}"
        case UnusedCliTokensError(unused_tokens=[*words]):
            return f"too many words: {', '.join(map(repr, words))}"
    return str(error)


def _wrong_value(error: CoercionError) -> str:
    argument, token = error.argument, error.token
    name = (token.keyword if token else None) or (argument.name if argument else "")
    if error.msg is not None:  # of a function in arguments.py
        return f"argument {name}: {error.msg}"
    value = token.value if token else ""
    choices = argument.get_choices(force=True) if argument else None
    if not choices and get_origin(error.target_type) is Literal:  # one of several values of an option
        choices = tuple(map(str, get_args(error.target_type)))
    if choices:
        return f"argument {name}: {_not_one_of(value, choices)}"
    kind = getattr(error.target_type, "__name__", str(error.target_type))
    return f"argument {name}: {value!r} is not valid; expected {_KINDS.get(kind, kind)}"


_KINDS = {"int": "an integer", "float": "a number", "bool": "no value"}


def _unknown_option(word: str, names: Iterable[str]) -> str:
    option = word.partition("=")[0]
    return f"unknown option {option}{did_you_mean(option, list(names))}"


def _unknown_command(word: str, app: App | None) -> str:
    if app is None:
        return f"argument COMMAND: {word!r} is not valid"
    if word.startswith("-") and word != "-":
        flags = [name for name in (*app, "--workpieces") if name.startswith("--")]
        return f"{_unknown_option(word, flags)}; options of a command follow its name"
    return f"argument COMMAND: {_not_one_of(word, commands_of(app))}"


def _not_one_of(value: str, known: Sequence[str]) -> str:
    return f"{value!r} is not valid; expected one of: {', '.join(known)}{did_you_mean(value, known)}"
