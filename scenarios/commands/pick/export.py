"""`pickproof export DIR --parquet FILE`: the attempts of a campaign as one table that other tools read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pickproof.scenarios.commands.arguments import FILE_TO_WRITE, ResultsFolder, about


def export(
    directory: ResultsFolder,
    /,
    *,
    parquet: Annotated[Path, FILE_TO_WRITE, about("written whole or not at all")],
) -> int:
    """`pickproof export DIR --parquet FILE`."""
    from pickproof.scenarios.reporting.parquet import to_table, write_parquet
    from pickproof.scenarios.results.campaign_results import CampaignResults

    table = to_table(CampaignResults.open(directory))
    write_parquet(table, parquet)
    print(f"wrote {parquet}: {table.num_rows} attempts, {table.num_columns} columns")
    return 0
