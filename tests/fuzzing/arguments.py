"""Hostile command lines: `hostile` draws one, `check` runs it in this process and looks at what came of it.

Options are taken from the commands themselves, so that new ones are met too. No command line starts long work: what
would is given a name that does not exist, or an option that does not. None names anything outside of its folder.
"""

from __future__ import annotations

from contextlib import chdir, redirect_stderr, redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path

import numpy as np
from cyclopts.argument import Argument, ArgumentCollection

from pickproof.scenarios.commands import cli
from pickproof.scenarios.commands.registry import build_app, typed_commands
from pickproof.scenarios.config.scenario import load_scenario
from tests.scenarios.planted_episode import write_campaign

NUMBERS = ("nan", "inf", "-inf", "-1", "0", "1e999", "-0.0", "0x10", "1,5", "1e-400", "9" * 400, "--1", "½")
PATHS = ("", " ", "file", "folder", "missing", "missing/below", "file/below", "file.yaml", "folder.yaml",
         "locked.yaml", "new.json", "empty", ".", "~", "*", "x" * 300)  # fmt: skip
TEXTS = ("", "-", "--", "-x", "nosuch", "brackett", "a=b", "count=nan", "count=[", "=1", "count=", "a.b.c=1", "a\nb",
         "a\tb", "\udcff", "é", "%s", "{}", "'; --", "1:2:0", "count=1:inf", "wrist.noise_N=.nan", "count=2001-99-99",
         "count=" + "[" * 500, "count=*a", "count=!!float x", "camera=1", "robot=nosuch", "127.0.0.1:x")  # fmt: skip
WRONG = ("nosuch", "", " ", "braket", "folder", "file", "missing.yaml", "folder.yaml", "file.yaml", "locked.yaml",
         "a\nb", "é", "\udcff", "x" * 300, "nan", "-1", ".")  # fmt: skip
"""Neither a scenario, nor a workpiece, nor results, nor a mesh."""
CAMPAIGN = "campaign"
QUICK = ("list", "explain", "report", "index", "compare", "export", "export-program", "baseline", "replay")
"""Commands that may be given the results of a campaign, on which they are done at once."""


def hostile(rng: np.random.Generator) -> list[str]:
    """A command line in which something is probably wrong."""
    commands = _commands()
    names = sorted(commands)
    name = names[rng.integers(len(names))]
    arguments = [a for a in commands[name] if a.parse and a.show]
    options = [a for a in arguments if a.name.startswith("--")]
    words = ["--help"] if rng.random() < 0.05 else []
    words += [w for a in options if rng.random() < _share(a) for w in _option(a, rng)]
    positional = [a for a in arguments if not a.name.startswith("-")]
    good = name in QUICK and rng.random() < 0.7
    for argument in positional:
        repeats = 1 + int(argument.token_count()[1] and rng.random() < 0.3)
        words += [CAMPAIGN if good and rng.random() < 0.9 else _draw(WRONG, rng) for _ in range(repeats)]
    if rng.random() < 0.3:
        words.insert(rng.integers(len(words) + 1), _draw(NUMBERS + PATHS + TEXTS, rng))
    command = name.split()
    if name not in QUICK and not any(a.required for a in positional):
        words.append("--no-such-option")  # without it all of the defaults would be run
    if rng.random() < 0.1:
        command[-1] = command[-1][:-1] + _draw(("", "x", "-", "\u00e9"), rng)
    at = rng.integers(len(command) + 1)
    if rng.random() < 0.2:
        command[at:at] = ["--workpieces", _draw(PATHS, rng)]
    if rng.random() < 0.1:
        command.insert(0, _draw(TEXTS, rng))
    return command + words


def check(words: list[str], folder: Path) -> str:
    """`ran` or `refused`, run in `folder`, which is furnished with what `hostile` names.

    Raises:
        AssertionError: another exit code than 0 to 3, a traceback, or a refusal that is not one line.
    """
    furnish(folder)
    out, err = StringIO(), StringIO()
    with chdir(folder), redirect_stdout(out), redirect_stderr(err):
        code = cli.main(words)
    said = err.getvalue()
    assert code in (0, 1, 2, 3), f"{words}: exit code {code}: {said}"
    assert "Traceback" not in said + out.getvalue(), f"{words}: {said}"
    if code != 2:
        return "ran"
    one_line = said.startswith("pickproof: error: ") and said.count("\n") == 1 and said.endswith("\n")
    assert one_line, f"{words}: {said!r}"
    return "refused"


def furnish(folder: Path) -> None:
    """Make the files and folders that `hostile` names, where they are not there yet."""
    if (folder / CAMPAIGN).exists():
        return
    for name in ("folder", "folder.yaml", "empty"):
        (folder / name).mkdir()
    (folder / "file").write_bytes(b"\xff\xfe no text \x00")
    (folder / "file.yaml").write_bytes(b"count: \xff[")
    (folder / "locked.yaml").touch(mode=0o000)
    scenario = load_scenario("bracket", ["count=4", "stop.attempt_limit=4"])
    write_campaign(folder / CAMPAIGN, scenario, range(3), versions={"pickproof": "0"})


@cache
def _commands() -> dict[str, ArgumentCollection]:
    """Name with that of the command above it -> its arguments."""
    app = build_app()
    found = {}
    for name in typed_commands():
        command = app
        for word in name.split():
            command = command[word]
        found[name] = command.assemble_argument_collection()
    return found


def _share(argument: Argument) -> float:
    """How often an option is given."""
    return 0.9 if argument.required else 0.15


def _option(argument: Argument, rng: np.random.Generator) -> list[str]:
    name = argument.name
    count = argument.token_count()[0]
    if count == 0:
        return [name]
    choices = argument.get_choices(force=True)
    if choices and rng.random() < 0.7:
        values = [_draw(tuple(choices), rng)]
    else:
        pool = PATHS if "Path" in str(argument.hint) else NUMBERS + PATHS + TEXTS
        values = [_draw(pool, rng)]
    if count > 1:
        values = [_draw(NUMBERS, rng) for _ in range(count)]
    if name == "--attempt" and rng.random() < 0.7:
        values = [str(rng.integers(4))]
    return [f"{name}={values[0]}"] if len(values) == 1 and rng.random() < 0.5 else [name, *values]


def _draw(pool: tuple[str, ...], rng: np.random.Generator) -> str:
    return pool[rng.integers(len(pool))]
