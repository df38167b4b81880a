"""`pickproof index DIR...`: one page over many runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pickproof.scenarios.commands.arguments import FILE_TO_WRITE, about, parse_path, read_by


def index(
    directories: Annotated[
        tuple[Path, ...], read_by(parse_path, many=True), about("folder of a run, or with runs below it")
    ],
    /,
    *,
    out: Annotated[Path | None, FILE_TO_WRITE, about("default: out/index.html")] = None,
) -> int:
    """`pickproof index DIR...`."""
    from rich.console import Console

    from pickproof.scenarios.reporting.index import OUT, find_runs, read_run, write_index

    page = out or OUT
    runs = [read_run(folder, page) for folder in find_runs(list(directories))]
    Console().print(f"wrote {write_index(runs, page)}: {len(runs)} runs", soft_wrap=True)
    return 0
