"""`pickproof report DIR`: the report of a campaign as one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pickproof.scenarios.commands.arguments import FILE_TO_WRITE, ResultsFolder, about


def report(
    directory: ResultsFolder,
    /,
    *,
    out: Annotated[Path | None, FILE_TO_WRITE, about("default: DIR/report.html")] = None,
) -> int:
    """`pickproof report DIR`."""
    from pickproof.scenarios.reporting.report import write_report

    print(f"wrote {write_report(directory, out)}")
    return 0
