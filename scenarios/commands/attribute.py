"""`pickproof attribute SCENARIO`: what each stage of a pick costs, and so what to mend first."""

from __future__ import annotations

import argparse
import json
import shlex
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console

from pickproof.cell.errors import InputError
from pickproof.scenarios.campaign.job import Runner
from pickproof.scenarios.commands.arguments import MAX_SEED, add_scenario_arguments, folder_to_write, integer
from pickproof.scenarios.comparison.attribution import (
    MODES,
    Attribution,
    attribute,
    plot_attribution,
    print_attribution,
    verdict_line,
)
from pickproof.scenarios.comparison.paired import outcomes
from pickproof.scenarios.comparison.sweep import Point, run_point
from pickproof.scenarios.config.scenario import Scenario, load_scenario
from pickproof.scenarios.files.atomic import write_json
from pickproof.scenarios.results.broken_campaign import check_ran
from pickproof.scenarios.results.store import FILE, Store


def folder_of(mode: tuple[str, ...]) -> str:
    """Name of the folder of a campaign in which these stages are replaced."""
    return "+".join(mode) or "nothing"


def run_modes(
    scenario: Scenario,
    episodes: int,
    workers: int,
    out: Path,
    runner: Runner,
    command: str,
    say: Callable[[str], None] = lambda text: None,
) -> Attribution:
    """Run, or continue, one campaign for each of MODES over the same bins, and compare them.

    Leaves a results file and a summary in a folder of `out` each, and there `attribution.json` and `attribution.png`.
    """
    summaries: list[dict[str, Any]] = []
    known, folders = [], []
    for mode in MODES:
        folder = out / folder_of(mode)
        say(f"{len(summaries) + 1} of {len(MODES)}: replaced by ground truth: {folder_of(mode)}")
        summaries.append(
            run_point(Point((), scenario, folder), episodes, workers, frozenset(mode), runner, command, {})
        )
        with Store.read(folder) as store:
            attempts = store.attempts(large=False)
            known.append(outcomes(attempts, store.episodes()))
        folders.append(folder / FILE)
    result = attribute(known, summaries, folders, Counter(a.grasp for a in attempts if a.moved and not a.success))
    write_json(out / "attribution.json", as_document(result, command))
    plot_attribution(result, out / "attribution.png")
    return result


def as_document(a: Attribution, command: str) -> dict[str, Any]:
    """The attribution as JSON."""
    modes = [
        {"replaced": list(mode), "folder": folder_of(mode), "summary": s}
        for mode, s in zip(MODES, a.summaries, strict=True)
    ]
    return {
        "episodes": a.episodes,
        "named": a.named,
        "basis": a.basis,
        "verdict": verdict_line(a),
        "rest": a.rest,
        "rest_points_at": a.rest_points_at,
        "rest_by_grasp": a.rest_by_grasp,
        "stages": [asdict(s) for s in a.stages],
        "modes": modes,
        "command": command,
    }


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `pickproof attribute`."""
    add_scenario_arguments(parser)
    parser.epilog = f"four campaigns over the same bins, with {', '.join(folder_of(m) for m in MODES)} replaced"
    parser.add_argument("--episodes", type=integer(2, 1_000_000), default=10, metavar="N", help="of each (default 10)")
    parser.add_argument("--seed", type=integer(0, MAX_SEED), metavar="S", help="of the first; default: the scenario's")
    parser.add_argument("--out", type=folder_to_write, metavar="DIR", help="default: out/attribute-SCENARIO")
    parser.add_argument("--resume", action="store_true", help="continue what --out holds")
    parser.add_argument("--json", action="store_true", help="print the result as JSON; progress goes to stderr")


def main(args: argparse.Namespace) -> int:
    """Run the command; returns the exit code."""
    from pickproof.scenarios.campaign.episode import run_episode
    from pickproof.scenarios.picking.workcell import check_inputs

    if args.oracle:
        raise InputError("command line", "--oracle", " ".join(args.oracle), "none: all of them are run one by one")
    scenario = load_scenario(args.scenario, args.set)
    if args.seed is not None:
        scenario = scenario.model_copy(update={"seed": args.seed})
    out = args.out or Path("out") / f"attribute-{scenario.name}"
    if not args.resume and any((out / folder_of(mode) / FILE).is_file() for mode in MODES):
        raise InputError("command line", "--out", str(out), "a folder without results, or --resume to continue them")
    check_inputs(scenario, frozenset())
    console, command = Console(stderr=args.json), f"pickproof {shlex.join(args.words)}"
    say = lambda text: console.print(text, highlight=False)  # noqa: E731
    result = run_modes(scenario, args.episodes, args.workers, out, run_episode, command, say)
    for mode in MODES:
        check_ran(out / folder_of(mode))
    if args.json:
        print(json.dumps(as_document(result, command), indent=2))
    else:
        print_attribution(console, result)
        console.print(f"wrote {out / 'attribution.json'} and {out / 'attribution.png'}", soft_wrap=True)
    return 0
