"""`pickproof run SCENARIO`: a campaign, its results file and its summary."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from pathlib import Path

from rich.console import Console

from pickproof.cell.errors import InputError
from pickproof.scenarios.campaign.campaign import run_campaign
from pickproof.scenarios.campaign.request import CampaignRequest
from pickproof.scenarios.commands.arguments import MAX_SEED, add_scenario_arguments, folder_to_write, integer
from pickproof.scenarios.commands.live_view import LiveView
from pickproof.scenarios.config.scenario import load_scenario, weights_used
from pickproof.scenarios.files.atomic import free_folder
from pickproof.scenarios.results.broken_campaign import check_ran
from pickproof.scenarios.results.records import AttemptRecord
from pickproof.scenarios.results.replay_selection import Keep
from pickproof.scenarios.results.store import Store
from pickproof.scenarios.results.summary import FILE, counted, print_summary, summarise, write_summary


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `pickproof run`."""
    add_scenario_arguments(parser)
    parser.add_argument(
        "--episodes", type=integer(1, 1_000_000), default=10, metavar="N", help="bin fills (default 10)"
    )
    parser.add_argument("--seed", type=integer(0, MAX_SEED), metavar="S", help="of the first; default: the scenario's")
    parser.add_argument("--out", type=folder_to_write, metavar="DIR", help="default: out/SCENARIO-SEED")
    parser.add_argument("--resume", action="store_true", help="continue the campaign in --out")
    parser.add_argument(
        "--ray", metavar="ADDRESS", help="run on a Ray cluster: HOST:PORT, auto, or local to start one on this machine"
    )
    parser.add_argument("--no-pictures", action="store_true", help="keep no pictures of attempts")
    parser.add_argument(
        "--keep", choices=("failures", "all", "none"), default="failures", help="attempts kept for `pickproof replay`"
    )
    parser.add_argument("--json", action="store_true", help="print the summary as JSON; progress goes to stderr")
    parser.set_defaults(workers=None)


def main(args: argparse.Namespace) -> int:
    """Run the command; returns the exit code."""
    from pickproof.scenarios.campaign.episode import run_episode
    from pickproof.scenarios.picking.workcell import check_inputs

    scenario = load_scenario(args.scenario, args.set)
    seed = scenario.seed if args.seed is None else args.seed
    if seed + args.episodes - 1 > MAX_SEED:
        raise InputError("command line", "--seed", seed, f"at most {MAX_SEED} for the last episode")
    if args.resume and args.out is None:
        raise InputError("command line", "--resume", "no --out", "--out DIR with the results to continue")
    out = args.out or free_folder(Path("out") / f"{scenario.name}-{seed}")
    oracle = frozenset(args.oracle)
    check_inputs(scenario, oracle)
    console = Console(stderr=args.json)
    done = _ended(out) if args.resume else []
    if not args.json:
        console.print(
            f"{scenario.name}: {counted(args.episodes, 'episode')} of {counted(scenario.count, 'workpiece')}, "
            f"results in {out}",
            soft_wrap=True,
        )
    try:
        with LiveView(console, args.episodes, scenario.count, done) as view:
            request = CampaignRequest(
                scenario=scenario.model_copy(update={"seed": seed}),
                episodes=args.episodes,
                seed=seed,
                workers=args.workers or (0 if args.ray else 1),
                ray=args.ray,
                oracle=oracle,
                out=out,
                runner=run_episode,
                keep=Keep(out, args.keep),
                weights_hash=weights_used(scenario, oracle),
                command=f"pickproof {shlex.join(args.words)}",
                resume=args.resume,
                pictures=not args.no_pictures,
            )
            run_campaign(request, view.update)
    except KeyboardInterrupt:
        with Store.read(out) as store:
            kept = len(store.attempts(large=False))
        print(
            f"pickproof: interrupted; {kept} attempts are kept in {out}, --resume --out {out} continues",
            file=sys.stderr,
        )
        return 130
    with Store.read(out) as store:
        summary = summarise(store)
    write_summary(out, summary)
    if args.json:
        print(json.dumps(summary, indent=2))
    else:
        print_summary(console, summary)
        console.print(f"wrote {out / FILE}; a page with pictures: pickproof report {out}", soft_wrap=True)
    check_ran(out)
    return 0


def _ended(out: Path) -> list[AttemptRecord]:
    """Attempts of the episodes that have ended."""
    with Store.read(out) as store:
        ended = {e.seed for e in store.episodes()}
        return [a for a in store.attempts(large=False) if a.seed in ended]
