"""`pickproof index DIR...`: one page over many runs, with the trend of the rate over time and commits."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pickproof.cell.errors import InputError
from pickproof.cell.html_page import page_template
from pickproof.scenarios.files.atomic import write_whole
from pickproof.scenarios.reporting.figures import as_json, library, trend
from pickproof.scenarios.reporting.report import FILE as REPORT
from pickproof.scenarios.results.store import FILE, Store
from pickproof.scenarios.results.summary import interval, percent, seconds, summarise

OUT = Path("out/index.html")


@dataclass(frozen=True)
class Run:
    """One campaign: its folder, its summary, and what `provenance` noted; `link` is its report's, empty without.

    `first_only` campaigns end every bin after one attempt: their rate is that of full bins.
    """

    folder: Path
    summary: dict[str, Any]
    commit: str
    started: str
    command: str
    link: str
    first_only: bool


def find_runs(directories: Sequence[Path]) -> list[Path]:
    """Folders with results, the directories themselves or any below them, each once.

    Raises:
        InputError: a directory holds none.
    """
    found: dict[Path, None] = {}
    for directory in directories:
        mine = sorted(path.parent for path in directory.rglob(FILE))
        if not mine:
            raise InputError("command line", "DIR", str(directory), "a folder that `pickproof run` wrote, or one above")
        found.update(dict.fromkeys(mine))
    return list(found)


def read_run(folder: Path, page: Path) -> Run:
    """The campaign in a folder, for a page that will lie at `page`; runs of older versions know no commit and time."""
    with Store.read(folder) as store:
        meta, summary = store.meta(), summarise(store)
    report = folder / REPORT
    link = os.path.relpath(report, page.parent) if report.is_file() else ""
    first_only = json.loads(meta["scenario"])["stop"]["attempt_limit"] == 1
    return Run(folder, summary, meta.get("commit", ""), meta.get("started", ""), meta["command"], link, first_only)


def write_index(runs: Sequence[Run], path: Path) -> Path:
    """Write the page, a trend and a table for each scenario and set of oracles, oldest run first.

    Raises:
        StoreError: it cannot be written.
    """
    groups: dict[str, list[Run]] = {}
    for run in sorted(runs, key=lambda r: (r.started, str(r.folder))):
        oracle = " + ".join(run.summary["oracle"])
        title = run.summary["scenario"] + (f", oracle: {oracle}" if oracle else "")
        groups.setdefault(title, []).append(run)
    whole = {title: [run for run in mine if not run.first_only] for title, mine in groups.items()}
    figures = {title: as_json(_trend(mine)) for title, mine in whole.items() if len(mine) > 1}
    template = page_template(
        "pickproof.scenarios.reporting", "index.html.j2", percent=percent, interval=interval, seconds=seconds
    )
    page = template.render(groups=groups, figures=figures, plotly=library() if figures else "", short=_short)
    return write_whole(path, page)


def _trend(runs: Sequence[Run]) -> Any:
    labels = [f"{_short(r.commit) or r.folder.name}<br>{r.started[:10]}" for r in runs]
    rates, bounds = [r.summary["success_rate"] for r in runs], [r.summary["cluster95"] for r in runs]
    return trend(labels, rates, bounds, [f"scenario {r.summary['scenario_hash'][:8]}" for r in runs])


def _short(commit: str) -> str:
    return commit[:10] + "+" * commit.endswith("+")
