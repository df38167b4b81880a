"""`pickproof replay DIR --attempt N`: one attempt in 3-D, or as a film."""

from __future__ import annotations

import argparse
import time

from rich.console import Console

from pickproof.scenarios.commands.arguments import file_to_write, integer, some_path
from pickproof.scenarios.replay.data import Replayed
from pickproof.scenarios.replay.film import KINDS, record


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the command `replay`."""
    parser.add_argument("directory", type=some_path, metavar="DIR", help="where `pickproof run` wrote its results")
    parser.add_argument("--attempt", required=True, metavar="N", help="index in the report's list of every attempt")
    parser.add_argument("--port", type=integer(0, 65535), default=8080, help="of the page on 127.0.0.1 (default 8080)")
    parser.add_argument(
        "--record", type=file_to_write, metavar="FILE", help=f"write a film instead of a page: {', '.join(KINDS)}"
    )


def main(args: argparse.Namespace) -> int:
    """Run the command; returns the exit code."""
    console = Console()
    shown = Replayed.load(args.directory, args.attempt)
    if args.record:
        console.print(f"wrote {record(shown, args.record)}", soft_wrap=True)
        return 0
    from pickproof.scenarios.replay.page import ReplayPage

    page = ReplayPage(shown, args.port)
    console.print(f"attempt {shown.index}, {shown.outcome}: {page.url}   (Ctrl-C ends it)", soft_wrap=True)
    try:
        while True:
            time.sleep(3600)
    finally:
        page.close()
