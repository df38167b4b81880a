"""Choose the value of a field on some bins, and check the choice on unseen bins.

python examples/tune_field.py --field grasping.weight_height --values 0 0.5 1
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from pickproof import Campaign, compare, load_scenario

UNSEEN = 1000
"""Seed of the first unseen bin."""


def main(words: Sequence[str] | None = None) -> int:
    """One campaign a value, then two over unseen bins; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", default="bracket")
    parser.add_argument("--field", default="grasping.weight_height")
    parser.add_argument("--values", nargs="+", default=["0.0", "0.5", "1.0"])
    parser.add_argument("--episodes", type=int, default=4)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--count", type=int, default=10, help="workpieces a bin")
    parser.add_argument("--out", type=Path, default=Path("out/tune-field"))
    args = parser.parse_args(words)

    def run(value: str | None, folder: str, seed: int) -> Campaign:
        changes = [f"count={args.count}"] + ([f"{args.field}={value}"] if value is not None else [])
        scenario = load_scenario(args.scenario, changes)
        how = {"episodes": args.episodes, "workers": args.workers, "oracle": ["perception"]}
        return Campaign.run(scenario, seed=seed, out=args.out / folder, **how)

    cleared: dict[str, float] = {}
    for value in args.values:
        cleared[value] = run(value, f"value-{value}", seed=0).summary["clearance"]
        print(f"{args.field} = {value}: {100 * cleared[value]:.1f} % of the workpieces picked")
    best = max(args.values, key=cleared.__getitem__)
    before, after = run(None, "unseen-before", UNSEEN), run(best, "unseen-after", UNSEEN)
    found = compare(before, after)
    print(f"{args.field} = {best} on unseen bins: pick success {found.verdict}")
    if found.clearance is not None:
        print(f"  clearance {100 * found.clearance.a:.1f} -> {100 * found.clearance.b:.1f} %")
    return 0


if __name__ == "__main__":  # the worker processes of a campaign import this file
    raise SystemExit(main())
