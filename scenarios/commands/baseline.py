"""`pickproof baseline`: measures a system and writes its baseline."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

from pickproof.scenarios.commands.arguments import (
    MAX_SEED,
    add_change_arguments,
    file_to_write,
    folder_to_write,
    integer,
)
from pickproof.scenarios.comparison.baseline import Baseline, Execution, baseline_of, write_baseline
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.results.broken_campaign import check_ran
from pickproof.scenarios.results.store import FILE


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `pickproof baseline`."""
    parser.add_argument(
        "source", metavar="SCENARIO|DIR", help="a scenario to run, or the folder of a campaign that was run"
    )
    parser.add_argument("--baseline", type=file_to_write, metavar="FILE", help="default: NAME.baseline.json")
    parser.add_argument("--episodes", type=integer(1, 100_000), default=200, metavar="N", help="bins (default 200)")
    parser.add_argument("--seed", type=integer(0, MAX_SEED), metavar="S", help="of the first; default: the scenario's")
    parser.add_argument("--whole", action="store_true", help="run whole episodes, not their first attempts alone")
    parser.add_argument(
        "--out", type=folder_to_write, metavar="DIR", help="results of the run; default: out/baseline-SCENARIO"
    )
    parser.add_argument("--resume", action="store_true", help="continue the run in --out")
    add_change_arguments(parser)


def main(args: argparse.Namespace) -> int:
    """`pickproof baseline SCENARIO|DIR`."""
    folder = Path(args.source)
    baseline = baseline_of(folder) if (folder / FILE).is_file() else _run(args)
    path = write_baseline(args.baseline or Path(f"{baseline.name}.baseline.json"), baseline)
    first = sum(o.first for o in baseline.outcomes)
    print(f"wrote {path}: {len(baseline.rows)} episodes, {first} first attempts succeeded")
    return 0


def _run(args: argparse.Namespace) -> Baseline:
    from pickproof.scenarios.campaign.episode import run_episode
    from pickproof.scenarios.picking.workcell import check_inputs

    scenario = load_scenario(args.source, args.set)
    oracle = frozenset(args.oracle)
    check_inputs(scenario, oracle)
    out = args.out or Path("out") / f"baseline-{scenario.name}"
    how = Execution(out, run_episode, args.workers, oracle, args.resume, f"pickproof {shlex.join(args.words)}")
    seed = scenario.seed if args.seed is None else args.seed
    how.run(scenario, "success" if args.whole else "first_attempt", seed, args.episodes)
    check_ran(out)
    return baseline_of(out)
