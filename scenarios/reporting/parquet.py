"""The attempts of a campaign as a Parquet file, which other tools read."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pickproof.cell.errors import InputError
from pickproof.scenarios.files.atomic import StoreError
from pickproof.scenarios.results.campaign_results import Campaign, columns
from pickproof.scenarios.results.records import AttemptRecord

if TYPE_CHECKING:
    import pyarrow

_TOLD = ("scenario_hash", "weights_hash", "inputs_hash", "seed", "oracle", "versions", "command")


def to_table(campaign: Campaign) -> pyarrow.Table:
    """One row an attempt: single values as they are, matrices as lists of rows, tree and waypoints as JSON.

    What was run stands in the schema's metadata under `pickproof`, as JSON.

    Raises:
        InputError: pyarrow is not installed.
    """
    try:
        import pyarrow as pa
    except ImportError:
        raise InputError("command line", "--parquet", "no pyarrow", "pip install 'pickproof[data]'") from None
    attempts = campaign.attempts
    rows = pa.list_(pa.list_(pa.float64()))
    simple = {"bool": pa.bool_(), "int": pa.int64(), "float": pa.float64(), "float | None": pa.float64()}
    values = columns(attempts, campaign.episodes)
    kind = dict.fromkeys(values, pa.string()) | {"compute_s": pa.float64(), "cycle_s": pa.float64()}
    kind |= {f.name: simple[str(f.type)] for f in fields(AttemptRecord) if f.type in simple}
    for name in ("estimate_T_world_part", "part_poses_after"):
        values[name], kind[name] = [getattr(a, name) for a in attempts], rows
    for name in ("tree", "waypoints"):
        values[name], kind[name] = [_json(getattr(a, name)) for a in attempts], pa.string()
    told = {key: campaign.meta[key] for key in _TOLD if key in campaign.meta}
    schema = pa.schema(list(kind.items()), metadata={"pickproof": json.dumps(told, sort_keys=True)})
    return pa.table(values, schema=schema)


def _json(value: Any) -> str | None:
    return None if value is None else json.dumps(value)


def write_parquet(table: pyarrow.Table, path: Path) -> None:
    """Write a table, whole or not at all.

    Raises:
        InputError: `path` is no regular file.
        StoreError: it cannot be written.
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
