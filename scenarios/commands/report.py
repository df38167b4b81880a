"""`pickproof report DIR`: the report of a campaign as one HTML page."""

from __future__ import annotations

import argparse

from pickproof.scenarios.commands.arguments import file_to_write, some_path
from pickproof.scenarios.reporting.report import FILE, write_report


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `pickproof report`."""
    parser.add_argument("directory", type=some_path, metavar="DIR", help="where `pickproof run` wrote its results")
    parser.add_argument("--out", type=file_to_write, metavar="FILE", help=f"default: DIR/{FILE}")


def main(args: argparse.Namespace) -> int:
    """`pickproof report DIR`."""
    print(f"wrote {write_report(args.directory, args.out)}")
    return 0
