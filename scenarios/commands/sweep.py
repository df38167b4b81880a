"""`pickproof sweep`: a campaign for every combination of values."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

from rich.console import Console

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.arguments import MAX_SEED, add_scenario_arguments, folder_to_write, integer
from pickproof.scenarios.comparison.sweep import parse_axis, plan, plot_sweep, print_sweep, run_point
from pickproof.scenarios.files.atomic import write_json
from pickproof.scenarios.results.broken_campaign import NothingMeasuredError, broken


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `pickproof sweep`."""
    add_scenario_arguments(parser)
    parser.epilog = "--set takes FIELD=VALUE,VALUE,... or FIELD=LOW:HIGH:STEP; every combination is run"
    parser.add_argument("--episodes", type=integer(1, 1_000_000), default=10, metavar="N", help="of each (default 10)")
    parser.add_argument("--seed", type=integer(0, MAX_SEED), metavar="S", help="of the first; default: the scenario's")
    parser.add_argument(
        "--out", type=folder_to_write, metavar="DIR", help="default: out/sweep-SCENARIO; what it holds is kept"
    )


def main(args: argparse.Namespace) -> int:
    """`pickproof sweep SCENARIO --set FIELD=...`."""
    from pickproof.scenarios.campaign.episode import run_episode
    from pickproof.scenarios.picking.workcell import check_inputs

    axes, oracle = [parse_axis(text) for text in args.set], frozenset(args.oracle)
    if not axes or len({a.field for a in axes}) < len(axes):
        raise InputError("command line", "--set", args.set, "one or more fields, each once")
    out = args.out or Path("out") / f"sweep-{Path(args.scenario).stem}"
    points = plan(args.scenario, axes, args.seed, out)
    for point in points:
        check_inputs(point.scenario, oracle)
    console, rows, lasted_s = Console(), [], dict[int, float]()
    for i, point in enumerate(points):
        values = {a.field: v for a, v in zip(axes, point.values, strict=True)}
        with console.status(f"{i + 1} of {len(points)}: {values}"):
            summary = run_point(
                point, args.episodes, args.workers, oracle, run_episode, f"pickproof {shlex.join(args.words)}", lasted_s
            )
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
