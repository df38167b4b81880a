"""`pickproof report DIR`: one self-contained HTML page; it fetches nothing."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pickproof.cell.html_page import page_template, png_uri
from pickproof.grasping.verdict import CHOSEN
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.files.atomic import write_whole
from pickproof.scenarios.reporting.figures import as_json, bin_map, cycle, dependence, library, pareto
from pickproof.scenarios.reporting.tables import (
    Share,
    by_place,
    classes,
    cycle_parts,
    fill_levels,
    grasp_points,
    tilt_deg,
    uncovered_percent,
    verdict_rows,
)
from pickproof.scenarios.reporting.verdict_counts import condensed, verdict_counts
from pickproof.scenarios.results.records import MEANING, NO_PICK_REASONS, AttemptRecord
from pickproof.scenarios.results.replay_file import path_of
from pickproof.scenarios.results.store import Store
from pickproof.scenarios.results.summary import interval, leaves_parts, percent, seconds, summarise

FILE = "report.html"
PICTURE_BYTES = 3_500_000
"""Pictures are embedded up to this size in all, before base64 makes them a third larger."""
SUCCESSES_SHOWN = 4
ROWS_SHOWN = 2000
ERRORS_MM = (0, 0.25, 0.5, 1, 2, 5)
TILTS_DEG = (0, 15, 30, 45, 60, 75)
COVERED = (0, 50, 70, 80, 90, 95)


@dataclass(frozen=True)
class Shown:
    """An attempt with its index in the list of all, its pictures as data URIs, and whether it can be replayed."""

    index: int
    attempt: AttemptRecord
    pictures: list[tuple[str, str]]
    replay: bool = False


def write_report(directory: Path, file: Path | None = None) -> Path:
    """Write a page from DIR/results.sqlite, to DIR/report.html by default.

    A campaign that was interrupted, or still runs, will do.

    Raises:
        InputError, StoreError: the results cannot be read, or the page cannot be written.
    """
    with Store.read(directory) as store:
        page = _render(store, directory)
    return write_whole(file or directory / FILE, page)


def choose_shown(store: Store, attempts: Sequence[AttemptRecord], budget: int = PICTURE_BYTES) -> list[Shown]:
    """Failures first, then no-picks, then successes spread over the campaign, while their pictures fit `budget`."""
    failed = [a for a in attempts if a.moved and not a.success]
    idle = [a for a in attempts if not a.moved]
    good = [a for a in attempts if a.success]
    spread = good[:: max(1, len(good) // SUCCESSES_SHOWN)][:SUCCESSES_SHOWN] if good else []
    # some room is kept for successes, so that a bad campaign still shows what a good pick looks like
    shown, left = _embed(store, spread[:2], budget // 4)
    first, left = _embed(store, failed, budget - budget // 4 + left)
    between, left = _embed(store, idle[:SUCCESSES_SHOWN], left)
    last, _ = _embed(store, spread[2:], left)
    index = {(a.seed, a.attempt): i for i, a in enumerate(attempts)}
    folder = store.path.parent
    return [
        replace(x, index=index[a.seed, a.attempt], replay=path_of(folder, a.seed, a.attempt).is_file())
        for x in first + between + shown + last
        for a in [x.attempt]
    ]


def _embed(store: Store, attempts: Sequence[AttemptRecord], budget: int) -> tuple[list[Shown], int]:
    shown = []
    for a in attempts:
        pictures = store.pictures(a.seed, a.attempt)
        size = sum(len(png) for png in pictures.values())
        if not pictures or size > budget:
            continue
        budget -= size
        uris = [(n, png_uri(png)) for n, png in pictures.items()]
        shown.append(Shown(0, a, uris))
    return shown, budget


def _render(store: Store, directory: Path) -> str:
    attempts = list(store.each_attempt(without=("waypoints",), tree=condensed))
    template = page_template(
        "pickproof.scenarios.reporting",
        "report.html.j2",
        percent=percent,
        interval=interval,
        seconds=seconds,
        readable=_readable,
    )
    summary = summarise(store, attempts)
    numbers, pictures = _numbers(store.meta(), summary, attempts), _pictures(store, summary, attempts)
    return template.render(**numbers, **pictures, directory=directory, episodes=store.episodes())


def _numbers(meta: dict[str, Any], summary: dict[str, Any], attempts: Sequence[AttemptRecord]) -> dict[str, Any]:
    """What the page's tables show."""
    scenario, grasps = Scenario.model_validate_json(meta["scenario"]), grasp_points(attempts)
    return {
        "s": summary,
        "meta": meta,
        "leaves_parts": leaves_parts(summary, scenario.stop.attempt_limit, scenario.count),
        "unfinished": meta["episodes"] - summary["episodes"],
        "reasons": _reasons(summary),
        "most": max(summary["reasons"].values(), default=1),
        "meaning": {str(k): v for k, v in MEANING.items()},
        "fill": fill_levels(attempts),
        "grasps": [g for g in grasps if g.n],
        "unused_grasps": [g for g in grasps if not g.n],
        "cycle": cycle_parts(attempts),
        "verdicts": verdict_rows(attempts),
        "verdicts_of": lambda a: ", ".join(f"{n} {v}" for v, n in verdict_counts(a.tree).most_common() if v != CHOSEN),
        "attempts": attempts[:ROWS_SHOWN],
        "omitted": max(0, len(attempts) - ROWS_SHOWN),
        "accuracy": _accuracy([a for a in attempts if a.moved]),
        "scenario": json.dumps(json.loads(meta["scenario"]), indent=2),
    }


def _pictures(store: Store, summary: dict[str, Any], attempts: Sequence[AttemptRecord]) -> dict[str, Any]:
    """Charts, and pictures of single attempts."""
    shown = choose_shown(store, attempts)
    scenario = Scenario.model_validate_json(store.meta()["scenario"])
    return {
        "figures": _figures(scenario, attempts, _reasons(summary)),
        "plotly": library(),
        "shown": shown,
        "failures": sum(a.moved and not a.success for a in attempts),
        "failures_shown": sum(x.attempt.moved and not x.attempt.success for x in shown),
    }


def _reasons(summary: dict[str, Any]) -> list[tuple[str, int, bool]]:
    """Reason, count, and whether it is one of no-picks; most frequent first."""
    no_picks = {str(r) for r in NO_PICK_REASONS}
    return [(r, n, r in no_picks) for r, n in summary["reasons"].items()]


def _figures(
    scenario: Scenario, attempts: Sequence[AttemptRecord], reasons: Sequence[tuple[str, int, bool]]
) -> dict[str, str]:
    """Name -> figure as JSON; those that have nothing to show are left out."""
    panels: dict[str, Sequence[Share]] = {
        "workpieces in the bin": [f for f in fill_levels(attempts)[::-1] if f.n],
        "uncovered share of the workpiece": classes(attempts, uncovered_percent, COVERED, " %"),
        "error of the chosen estimate": classes(attempts, lambda a: a.error_mm, ERRORS_MM, " mm"),
        "tilt of the workpiece": classes(attempts, tilt_deg, TILTS_DEG, " deg"),
    }
    panels = {name: shares for name, shares in panels.items() if any(s.n for s in shares)}
    good, tried = by_place(attempts, scenario.source_bin.build("source"))
    found = {"pareto": pareto(reasons)} if len(reasons) > 1 else {}
    if panels:
        found["cycle"] = cycle(cycle_parts(attempts))
        found |= {f"dependence_{i}": dependence(name, shares) for i, (name, shares) in enumerate(panels.items())}
    if tried.any():
        found["bin_map"] = bin_map(good, tried, scenario.source_bin.inner)
    return {name: as_json(figure) for name, figure in found.items()}


def _accuracy(attempts: Sequence[AttemptRecord]) -> dict[str, float] | None:
    """Medians of the chosen estimates' errors, in [mm] and [deg]."""
    pairs = sorted((a.error_mm, a.error_deg) for a in attempts if a.error_mm is not None and a.error_deg is not None)
    if not pairs:
        return None
    return {"mm": pairs[len(pairs) // 2][0], "deg": sorted(d for _, d in pairs)[len(pairs) // 2]}


def _readable(value: Any) -> str:
    return str(value).replace("_", " ")
