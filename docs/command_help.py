"""A hook of mkdocs: puts the help of the program into the page of the commands, where it says `<!-- help: run -->`."""

from __future__ import annotations

import contextlib
import io
import os
import re
from typing import Any

HELP = re.compile(r"<!-- help: (.*?) -->")
WIDTH = "100"  # [characters]


def help_text(command: str) -> str:
    """What `pickproof COMMAND --help` prints."""
    from pickproof.scenarios.commands.cli import main

    printed = io.StringIO()
    os.environ["COLUMNS"] = WIDTH
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        main([*command.split(), "--help"])
    return printed.getvalue().rstrip()


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Called by mkdocs for each page."""
    return HELP.sub(lambda m: f"```text\n{help_text(m[1])}\n```", markdown)
