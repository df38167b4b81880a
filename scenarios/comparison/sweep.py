"""`pickproof sweep`: a campaign for every combination of values, over the same bins, in one table and one picture."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from pickproof.cell.config import yaml_value
from pickproof.cell.errors import InputError
from pickproof.scenarios.campaign.campaign import run_campaign
from pickproof.scenarios.campaign.job import Runner
from pickproof.scenarios.campaign.request import CampaignRequest
from pickproof.scenarios.config.scenario import Scenario, load_scenario, scenario_hash, weights_used
from pickproof.scenarios.results.store import FILE, Store
from pickproof.scenarios.results.summary import interval, percent, summarise, write_summary

LIMIT = 200
"""Combinations of a sweep at most."""


@dataclass(frozen=True)
class Axis:
    """A field and its values, each as YAML text."""

    field: str
    values: tuple[str, ...]


@dataclass(frozen=True)
class Point:
    """A combination of values, its scenario, and the folder of its campaign."""

    values: tuple[str, ...]
    scenario: Scenario
    folder: Path


def parse_axis(text: str) -> Axis:
    """`field=1,2,5`, or `field=low:high:step` with both ends; a comma in brackets does not separate.

    Raises:
        InputError: there is no field, no value, or a range that does not end.
    """
    field, equals, values = text.partition("=")
    found = tuple(v.strip() for v in re.split(r",(?![^\[{]*[\]}])", values))
    if not equals or not field or not all(found):
        raise InputError("command line", "--set", text, "FIELD=VALUE,VALUE,... or FIELD=LOW:HIGH:STEP")
    stepless = re.fullmatch(r"[-+\d]+:[\d.]+", found[0])
    if len(found) == 1 and (found[0].count(":") == 2 or stepless):
        found = _range(text, found[0])
    return Axis(field, tuple(dict.fromkeys(found)))


def _range(text: str, values: str) -> tuple[str, ...]:
    numbers = [yaml_value(v) for v in values.split(":")]
    try:
        low, high, step = (float(n) for n in numbers)
        count = int(np.floor((high - low) / step + 1e-9)) + 1
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        count = 0
    if not 1 <= count <= LIMIT:
        raise InputError("command line", "--set", text, f"LOW:HIGH:STEP with 1 to {LIMIT} numbers")
    steps = [numbers[0] + i * numbers[2] for i in range(count)]
    return tuple(str(n) if isinstance(n, int) else f"{n:.10g}" for n in steps)


def plan(name: str, axes: Sequence[Axis], seed: int | None, out: Path) -> list[Point]:
    """All combinations, checked before the first is run.

    Raises:
        InputError: a value does not fit the schema, or there are too many combinations.
    """
    combinations = list(product(*(axis.values for axis in axes)))
    if len(combinations) > LIMIT:
        raise InputError("command line", "--set", f"{len(combinations)} combinations", f"at most {LIMIT}")
    points = []
    for values in combinations:
        scenario = load_scenario(name, [f"{a.field}={v}" for a, v in zip(axes, values, strict=True)])
        if seed is not None:
            scenario = scenario.model_copy(update={"seed": seed})
        points.append(Point(values, scenario, out / scenario_hash(scenario)[:16]))
    return points


def run_point(
    point: Point,
    episodes: int,
    workers: int,
    oracle: frozenset[str],
    runner: Runner,
    command: str,
    expected_s: dict[int, float],
) -> dict[str, Any]:
    """The summary of a combination's campaign, which is run, continued, or read where it is finished.

    `expected_s` holds what each seed's episode took last [s]; it is brought up to date.
    """
    request = CampaignRequest(
        scenario=point.scenario,
        episodes=episodes,
        seed=point.scenario.seed,
        workers=workers,
        oracle=oracle,
        out=point.folder,
        runner=runner,
        weights_hash=weights_used(point.scenario, oracle),
        expected_s=expected_s,
        command=command,
        resume=(point.folder / FILE).is_file(),
        pictures=False,
    )
    run_campaign(request)
    with Store.read(point.folder) as store:
        summary = summarise(store)
        expected_s.update((e.seed, e.wall_s) for e in store.episodes())
    write_summary(point.folder, summary)
    return summary


def print_sweep(console: Console, axes: Sequence[Axis], rows: Sequence[dict[str, Any]]) -> None:
    """A row a combination."""
    table = Table()
    shown = [a.field for a in axes if len(a.values) > 1] or [axes[0].field]
    for field in shown:
        table.add_column(field, justify="right", no_wrap=True)
    for column in ("pick success", "95 %", "attempts", "cleared", "no-picks", "first reason"):
        table.add_column(column, justify="right")
    for row in rows:
        s = row["summary"]
        worst = next((f"{r} {n}" for r, n in s["reasons"].items()), "none")
        rate = percent(s["success_rate"]), interval(s["cluster95"]), str(s["attempts"])
        table.add_row(
            *(row["values"][field] for field in shown), *rate, percent(s["clearance"]), str(s["no_picks"]), worst
        )
    console.print(table)


def plot_sweep(axes: Sequence[Axis], rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Small multiples: the field with most values along x, one panel for each combination of the others.

    Filled marks are the pick success with its 95 % interval, open ones the clearance.
    """
    from matplotlib.figure import Figure

    along = max(axes, key=lambda a: len(a.values))
    others = [a for a in axes if a is not along and len(a.values) > 1]
    panels = list(product(*(a.values for a in others)))
    columns = min(len(panels), len(others[-1].values) if others else 1, 4)
    lines = -(-len(panels) // columns)
    figure = Figure(figsize=(1 + 3.2 * columns, 0.6 + 2.6 * lines), layout="constrained")
    grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False).ravel()
    x = _positions(along.values)
    for panel, values in zip(grid, panels, strict=False):
        fixed = {a.field: v for a, v in zip(others, values, strict=True)}
        mine = [r["summary"] for r in rows if fixed.items() <= r["values"].items()]
        rate = np.array([np.nan if s["success_rate"] is None else s["success_rate"] for s in mine])
        bounds = np.array([s["cluster95"] for s in mine])
        reach = np.clip(np.abs(bounds.T - rate), 0, None)
        panel.errorbar(x, 100 * rate, yerr=100 * reach, fmt="o-", color="#1f5fa8", capsize=3, label="pick success")
        cleared = [np.nan if s["clearance"] is None else 100 * s["clearance"] for s in mine]
        panel.plot(x, cleared, "s", mfc="none", color="#b35900", label="clearance")
        panel.set_xticks(x, along.values)
        panel.set_title(", ".join(f"{f} = {v}" for f, v in fixed.items()), fontsize=9)
        panel.grid(axis="y", alpha=0.3)
    for panel in grid[len(panels) :]:
        panel.set_visible(False)
    grid[0].set_ylim(top=101)
    figure.legend(*grid[0].get_legend_handles_labels(), fontsize=8, loc="outside upper center", ncols=2)
    figure.supxlabel(along.field, fontsize=10)
    figure.supylabel("%", fontsize=10)
    figure.savefig(path, dpi=130)


def _positions(values: Sequence[str]) -> list[float]:
    """Numbers stand where they are, words and lists in a row."""
    numbers = [yaml_value(v) for v in values]
    if all(isinstance(n, int | float) and not isinstance(n, bool) for n in numbers):
        return [float(n) for n in numbers]
    return [float(i) for i in range(len(values))]
