"""`pickproof index DIR...`: one page over many runs."""

from __future__ import annotations

import argparse

from rich.console import Console

from pickproof.scenarios.commands.arguments import file_to_write, some_path
from pickproof.scenarios.reporting.index import OUT, find_runs, read_run, write_index


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the command `index`."""
    parser.add_argument("directories", type=some_path, nargs="+", metavar="DIR", help="of a run, or with runs below it")
    parser.add_argument("--out", type=file_to_write, default=OUT, metavar="FILE", help=f"default: {OUT}")


def main(args: argparse.Namespace) -> int:
    """Run the command; returns the exit code."""
    runs = [read_run(folder, args.out) for folder in find_runs(args.directories)]
    Console().print(f"wrote {write_index(runs, args.out)}: {len(runs)} runs", soft_wrap=True)
    return 0
