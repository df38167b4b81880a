"""Is the stage named that a fault was planted in? `python -m tests.benchmarks.attribution` (docs/statistics.md).

Three times four campaigns in the real physics over the same bins: as shipped, with noise on every estimate, and with
one grasp point moved by 4 mm. Half an hour and more; the same command again goes on.
"""

from __future__ import annotations

import argparse
import os
import shutil
from pathlib import Path

from rich.console import Console

from scenarios.attribute import folder_of, run_modes
from scenarios.attribution import MODES, print_attribution
from scenarios.episode import run_episode
from scenarios.scenario import load_scenario
from tests.benchmarks.planted_faults import move_grasps, noisy_perception

GRASP = "edge_of_plate"
"""Used in about a quarter of the picks of a bin of ten."""
EXPECTED = {"none": (None,), "perception": ("perception",), "grasp": ("grasp",)}


def main() -> int:
    """Run all, print the tables, and fail where the named stage is not the planted one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--out", type=Path, default=Path("out/attribution"))
    parser.add_argument("--faults", nargs="+", choices=EXPECTED, default=list(EXPECTED))
    args = parser.parse_args()
    console, wrong = Console(), 0
    scenario = load_scenario("bracket", [f"count={args.count}"])
    for fault in args.faults:
        out, runner = args.out / fault, run_episode
        os.environ.pop("PICKPROOF_WORKPIECES", None)
        if fault == "perception":
            runner = noisy_perception
            for mode in MODES[1:]:  # where the oracle perceives, the planted noise changes nothing, bit for bit
                if not (out / folder_of(mode)).exists() and (args.out / "none" / folder_of(mode)).exists():
                    shutil.copytree(args.out / "none" / folder_of(mode), out / folder_of(mode))
        if fault == "grasp":
            shutil.rmtree(args.out / "workpieces", ignore_errors=True)
            move_grasps(args.out / "workpieces", (GRASP,))
            os.environ["PICKPROOF_WORKPIECES"] = str((args.out / "workpieces").resolve())
        console.rule(f"planted: {fault}")
        result = run_modes(scenario, args.episodes, 1, out, runner, "tests.benchmarks.attribution", console.print)
        print_attribution(console, result)
        wrong += result.named not in EXPECTED[fault]
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
