"""`pickproof gate`: a system against its baseline."""

from __future__ import annotations

import argparse
import shlex
from dataclasses import asdict
from pathlib import Path

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.arguments import (
    add_scenario_arguments,
    file_to_write,
    folder_to_write,
    fraction,
    integer,
    some_path,
)
from pickproof.scenarios.comparison.baseline import Execution, read_baseline
from pickproof.scenarios.comparison.gate import EXIT, check_gate, junit, run_gate
from pickproof.scenarios.comparison.paired import MEASURES
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.files.atomic import free_folder, write_json, write_whole
from pickproof.scenarios.results.broken_campaign import check_ran
from pickproof.scenarios.results.store import FILE
from pickproof.scenarios.statistics.sequential_test import Rule


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `pickproof gate`."""
    rule = Rule()
    add_scenario_arguments(parser)
    parser.add_argument(
        "--baseline", type=some_path, required=True, metavar="FILE", help="that `pickproof baseline` wrote"
    )
    parser.add_argument("--measure", choices=MEASURES, default=MEASURES[0], help="default: first_attempt")
    parser.add_argument("--margin", type=fraction, default=rule.margin, help="loss that must not pass (default 0.02)")
    parser.add_argument("--alpha", type=fraction, default=rule.alpha, help="chance of a false alarm (default 0.05)")
    parser.add_argument(
        "--power", type=fraction, default=rule.power, help="1 - chance to pass what lost the margin (default 0.9)"
    )
    parser.add_argument(
        "--max-episodes", type=integer(1, 100_000), metavar="N", help="default: all that the baseline holds"
    )
    parser.add_argument("--out", type=folder_to_write, metavar="DIR", help="default: out/gate-SCENARIO")
    parser.add_argument("--resume", action="store_true", help="continue the gate in --out")
    parser.add_argument("--json", type=file_to_write, metavar="FILE", help="write the result as JSON")
    parser.add_argument("--junit", type=file_to_write, metavar="FILE", help="write the result as JUnit XML")


def main(args: argparse.Namespace) -> int:
    """`pickproof gate SCENARIO --baseline FILE`: exit code 0 passed, 1 worse, 3 undecided."""
    from rich.console import Console

    from pickproof.scenarios.campaign.episode import run_episode
    from pickproof.scenarios.picking.workcell import check_inputs

    scenario, baseline = load_scenario(args.scenario, args.set), read_baseline(args.baseline)
    oracle = frozenset(args.oracle)
    check_gate(scenario, baseline, args.measure, args.baseline)
    check_inputs(scenario, oracle)
    if args.resume and not (args.out and (args.out / FILE).is_file()):
        raise InputError("command line", "--resume", str(args.out), "--out DIR with the results to continue")
    out = args.out or free_folder(Path("out") / f"gate-{scenario.name}")
    with Console(stderr=True).status("no episode yet") as status:
        result = run_gate(
            scenario,
            baseline,
            file=args.baseline,
            rule=Rule(args.margin, args.alpha, args.power),
            how=Execution(out, run_episode, args.workers, oracle, args.resume, f"pickproof {shlex.join(args.words)}"),
            measure=args.measure,
            max_episodes=args.max_episodes,
            on_episode=lambda n: status.update(f"{n} paired episodes"),
        )
    check_ran(out)
    if args.json:
        write_json(args.json, {**asdict(result), "scenario": scenario.name, "exit_code": EXIT[result.decision]})
    if args.junit:
        write_whole(args.junit, junit(result, scenario.name))
    print(result.line)
    return EXIT[result.decision]
