"""`pickproof explain DIR --attempt N`: why one attempt did what it did."""

from __future__ import annotations

import argparse
import json

from rich.console import Console

from pickproof.scenarios.commands.arguments import some_path
from pickproof.scenarios.reporting.explain import ESTIMATES_SHOWN, explain
from pickproof.scenarios.results.store import Store


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the command `explain`."""
    parser.add_argument("directory", type=some_path, metavar="DIR", help="where `pickproof run` wrote its results")
    parser.add_argument("--attempt", required=True, metavar="N", help="index in the report's list of every attempt")
    parser.add_argument("--all", action="store_true", help=f"all estimates, not the first {ESTIMATES_SHOWN}")
    parser.add_argument("--json", action="store_true", help="print the tree as JSON")


def main(args: argparse.Namespace) -> int:
    """Run the command; returns the exit code."""
    with Store.read(args.directory) as store:
        attempt = store.nth_attempt(args.attempt)
    if args.json:
        head = {"seed": attempt.seed, "attempt": attempt.attempt, "success": attempt.success, "reason": attempt.reason}
        print(json.dumps(head | {"grasp": attempt.grasp, "tree": attempt.tree}, indent=2))
    else:
        explain(attempt, int(args.attempt), Console(), None if args.all else ESTIMATES_SHOWN)
    return 0
