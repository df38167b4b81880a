"""`pickproof export DIR --parquet FILE`: the attempts of a campaign as one table that other tools read."""

from __future__ import annotations

import argparse

from pickproof.scenarios.commands.arguments import file_to_write, some_path
from pickproof.scenarios.reporting.parquet import to_table, write_parquet
from pickproof.scenarios.results.campaign_results import CampaignResults


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `pickproof export`."""
    parser.add_argument("directory", type=some_path, metavar="DIR", help="folder of a campaign")
    parser.add_argument(
        "--parquet", type=file_to_write, required=True, metavar="FILE", help="written whole or not at all"
    )


def main(args: argparse.Namespace) -> int:
    """`pickproof export DIR --parquet FILE`."""
    table = to_table(CampaignResults.open(args.directory))
    write_parquet(table, args.parquet)
    print(f"wrote {args.parquet}: {table.num_rows} attempts, {table.num_columns} columns")
    return 0
