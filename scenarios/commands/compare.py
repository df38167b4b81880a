"""`pickproof compare A B`: two campaigns over the same bins."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from rich.console import Console

from pickproof.scenarios.commands.arguments import file_to_write, some_path
from pickproof.scenarios.comparison.compare import compare
from pickproof.scenarios.comparison.compare_text import print_comparison
from pickproof.scenarios.files.atomic import write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `pickproof compare`."""
    parser.add_argument("a", type=some_path, metavar="A", help="folder of a campaign")
    parser.add_argument("b", type=some_path, metavar="B", help="folder of another over the same bins")
    parser.add_argument("--json", type=file_to_write, metavar="FILE", help="write the comparison as JSON too")


def main(args: argparse.Namespace) -> int:
    """`pickproof compare A B`."""
    comparison = compare(args.a, args.b)
    if args.json:
        document: dict[str, Any] = {"a": str(args.a), "b": str(args.b), **asdict(comparison)}
        write_json(args.json, document)
    print_comparison(Console(), comparison, args.a, args.b)
    return 0
