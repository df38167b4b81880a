"""The attempts of a campaign as one table that other tools read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pickproof.cell.errors import InputError
from pickproof.scenarios.files.atomic import StoreError
from pickproof.scenarios.results.campaign_results import CampaignResults, columns
from pickproof.scenarios.results.columns import Column, columns_of
from pickproof.scenarios.results.records import AttemptRecord, Rows

if TYPE_CHECKING:
    import pyarrow

_NOTED = ("scenario_hash", "weights_hash", "inputs_hash", "seed", "oracle", "versions", "command")


def to_table(campaign: CampaignResults) -> pyarrow.Table:
    """One row an attempt: single values as they are, matrices as lists of rows, tree and waypoints as JSON.

    What was run stands in the schema's metadata under `pickproof`, as JSON.

    Raises:
        InputError: pyarrow is not installed.
    """
    try:
        import pyarrow as pa
    except ImportError:
        raise InputError("command line", "--parquet", "no pyarrow", "pip install 'pickproof[data]'") from None
    simple = {bool: pa.bool_(), int: pa.int64(), float: pa.float64(), str: pa.string()}
    values = columns(campaign.attempts, campaign.episodes)
    kinds = dict.fromkeys(values, pa.string()) | {"compute_s": pa.float64(), "cycle_s": pa.float64()}
    for column in columns_of(AttemptRecord):
        if column.kind is not None:
            kinds[column.name] = simple[column.kind]
            continue
        values[column.name] = [_nested(column, getattr(a, column.name)) for a in campaign.attempts]
        kinds[column.name] = pa.list_(pa.list_(pa.float64())) if column.hint == Rows else pa.string()
    noted = {key: campaign.meta[key] for key in _NOTED if key in campaign.meta}
    schema = pa.schema(list(kinds.items()), metadata={"pickproof": json.dumps(noted, sort_keys=True)})
    return pa.table(values, schema=schema)


def _nested(column: Column, value: Any) -> Any:
    return value if value is None or column.hint == Rows else json.dumps(value)


def write_parquet(table: pyarrow.Table, path: Path) -> None:
    """Write a table whole or not at all.

    Raises:
        InputError: `path` is something else than a file. StoreError: it cannot be written.
    """
    from pyarrow import parquet

    target = path.resolve()
    if target.exists() and not target.is_file():
        raise InputError("command line", "--parquet", str(path), "a regular file")
    partial = target.with_name(target.name + ".partial")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(table, partial, compression="zstd")
        partial.replace(target)
    except OSError as error:
        raise StoreError(f"{path}: cannot be written ({error.strerror or error})") from None
