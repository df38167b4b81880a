"""Is a planted fault caught by `gate` and named by `attribute`? `python -m tests.benchmarks.attribution`.

In the real physics, over the same bins: the system as shipped and with each fault of planted_faults.py against the
baseline of the shipped one, then four campaigns each with one stage more replaced by ground truth. The same command
again goes on; docs/explanation/attribution.md has the figures.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from rich.console import Console

from pickproof.scenarios.campaign.episode import run_episode
from pickproof.scenarios.comparison.attribution import MODES, Attribution, leads_the_rest, print_attribution
from pickproof.scenarios.comparison.attribution_run import folder_of, run_modes
from pickproof.scenarios.comparison.baseline import Baseline, Execution, baseline_of, read_baseline, write_baseline
from pickproof.scenarios.comparison.gate import GateResult, run_gate
from pickproof.scenarios.config.scenario import Scenario, load_scenario
from pickproof.scenarios.results.store import FILE
from pickproof.scenarios.statistics.sequential_test import Rule
from tests.benchmarks.planted_faults import FAULTS, planted

NAME = "tests.benchmarks.attribution"
BASELINE = "bracket.baseline.json"
DECISION = {"none": "passed"} | dict.fromkeys(FAULTS, "worse")
NAMED = {
    "none": None,
    "point": "the grasp points",
    "grasp": "the grasp points",
    "weights": "perception",
    "friction": "the grip",
}
"""No oracle mends worn pads or invents grasps: what is left when all stages are replaced leads, and points there."""
SHARED = ("weights",)
"""Where the oracle perceives, these weigh nothing: the other campaigns are those of the system as shipped."""


def main() -> int:
    """Run all, print the tables, and fail where a gate or the named stage is not as planted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=12, help="of each campaign")
    parser.add_argument("--count", type=int, default=6, help="workpieces a bin")
    parser.add_argument("--bins", type=int, default=30, help="of the baseline; one attempt each")
    parser.add_argument("--margin", type=float, default=0.1, help="of the gate")
    parser.add_argument("--out", type=Path, default=Path("out/attribution"))
    parser.add_argument("--faults", nargs="+", choices=DECISION, default=list(DECISION))
    parser.add_argument("--only", choices=("gate", "attribute"), help="default: both")
    args = parser.parse_args()
    console, wrong = Console(), 0
    baseline = None if args.only == "attribute" else _baseline(load_scenario("bracket", [f"count={args.count}"]), args)
    for fault in args.faults:
        console.rule(f"planted: {fault}")
        with planted(fault, args.out / fault) as changes:
            scenario = load_scenario("bracket", [f"count={args.count}", *changes])
            if baseline is not None:
                result = _gate(scenario, baseline, fault, args)
                console.print(result.line, soft_wrap=True, highlight=False)
                wrong += result.decision != DECISION[fault]
            if args.only != "gate":
                found = _attribute(scenario, fault, args, console)
                wrong += mended(found) != NAMED[fault]
    return 1 if wrong else 0


def mended(found: Attribution) -> str | None:
    """What the verdict says is to be mended first."""
    return found.rest_points_at if leads_the_rest(found) else found.named


def _baseline(shipped: Scenario, args: argparse.Namespace) -> Baseline:
    """First attempts of the system as shipped."""
    folder, file = args.out / "baseline", args.out / BASELINE
    if not file.exists():
        how = Execution(folder, run_episode, resume=(folder / FILE).is_file(), command=NAME)
        how.run(shipped, "first_attempt", shipped.seed, args.bins)
        write_baseline(file, baseline_of(folder))
    return read_baseline(file)


def _gate(scenario: Scenario, baseline: Baseline, fault: str, args: argparse.Namespace) -> GateResult:
    out, rule = args.out / fault / "gate", Rule(margin=args.margin)
    how = Execution(out, run_episode, resume=(out / FILE).is_file(), command=NAME)
    return run_gate(scenario, baseline, file=args.out / BASELINE, rule=rule, how=how)


def _attribute(scenario: Scenario, fault: str, args: argparse.Namespace, console: Console) -> Attribution:
    out = args.out / fault
    for mode in MODES[1:] if fault in SHARED else ():
        if not (out / folder_of(mode)).exists() and (args.out / "none" / folder_of(mode)).exists():
            shutil.copytree(args.out / "none" / folder_of(mode), out / folder_of(mode))
    result = run_modes(scenario, args.episodes, 1, out, run_episode, NAME, console.print)
    print_attribution(console, result)
    return result


if __name__ == "__main__":
    raise SystemExit(main())
