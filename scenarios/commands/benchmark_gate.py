"""`pickproof benchmark gate`: the error rates of the gate and the coverage of the intervals."""

from __future__ import annotations

import argparse

from rich.console import Console

from pickproof.scenarios.commands.arguments import file_to_write, integer
from pickproof.scenarios.comparison.gate_calibration import calibrate, print_tables
from pickproof.scenarios.files.atomic import write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `pickproof benchmark gate`."""
    parser.add_argument(
        "--campaigns", type=integer(10, 1_000_000), default=10_000, metavar="N", help="simulated gates (default 10000)"
    )
    parser.add_argument("--seed", type=integer(0, 2**31 - 1), default=0, metavar="S", help="of the simulation")
    parser.add_argument("--json", type=file_to_write, metavar="FILE", help="write the figures as JSON")


def main(args: argparse.Namespace) -> int:
    """`pickproof benchmark gate`."""
    found = calibrate(args.campaigns, args.seed)
    print_tables(Console(), found)
    if args.json:
        write_json(args.json, found)
    return 0
