"""`pickproof sweep`: a campaign for every combination of values."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.arguments import (
    FOLDER_TO_WRITE,
    Flat,
    ScenarioChanges,
    ScenarioName,
    Seed,
    about,
    integer,
)
from pickproof.scenarios.commands.invocation import command_line


@dataclass(frozen=True, kw_only=True)
class SweepOptions(ScenarioChanges):
    """Options of `pickproof sweep`."""

    set: Annotated[
        tuple[str, ...], about("FIELD=VALUE,VALUE,... or FIELD=LOW:HIGH:STEP; every combination is run")
    ] = ()
    episodes: Annotated[int, integer(1, 1_000_000), about("episodes of each combination")] = 10
    seed: Seed = None
    out: Annotated[
        Path | None, FOLDER_TO_WRITE, about("default: out/sweep-SCENARIO; finished combinations there are kept")
    ] = None


def sweep(
    scenario: ScenarioName,
    /,
    *,
    options: Annotated[SweepOptions, Flat] = SweepOptions(),
) -> int:
    """`pickproof sweep SCENARIO --set FIELD=...`."""
    from rich.console import Console

    from pickproof.scenarios.campaign.episode import run_episode
    from pickproof.scenarios.comparison.sweep import parse_axis, plan, plot_sweep, print_sweep, run_point
    from pickproof.scenarios.files.atomic import write_json
    from pickproof.scenarios.picking.workcell import check_inputs
    from pickproof.scenarios.results.broken_campaign import NothingMeasuredError, broken

    axes, oracle = [parse_axis(text) for text in options.set], frozenset[str](options.oracle)
    if not axes or len({a.field for a in axes}) < len(axes):
        raise InputError("command line", "--set", list(options.set), "one or more fields, each once")
    out = options.out or Path("out") / f"sweep-{Path(scenario).stem}"
    points = plan(scenario, axes, options.seed, out)
    for point in points:
        check_inputs(point.scenario, oracle)
    console, rows, lasted_s = Console(), [], dict[int, float]()
    for i, point in enumerate(points):
        values = {a.field: v for a, v in zip(axes, point.values, strict=True)}
        with console.status(f"{i + 1} of {len(points)}: {values}"):
            summary = run_point(point, options.episodes, options.workers, oracle, run_episode, command_line(), lasted_s)
        rows.append({"values": values, "folder": point.folder.name, "summary": summary})
        write_json(out / "sweep.json", {"fields": [a.field for a in axes], "rows": rows})
    plot_sweep(axes, rows, out / "sweep.png")
    print_sweep(console, axes, rows)
    console.print(f"wrote {out / 'sweep.json'} and {out / 'sweep.png'}", soft_wrap=True)
    empty = [said for point in points if (said := broken(point.folder))]
    if len(empty) == len(points):
        raise NothingMeasuredError(empty[0])
    for said in empty:
        print(f"pickproof: {said}", file=sys.stderr)
    return 0
