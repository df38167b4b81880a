"""Run a campaign, look at its failures, and compare it with a slower arm over the same bins.

python examples/run_campaign.py --episodes 8 --workers 2
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from pickproof import Campaign, compare, load_scenario


def main(words: Sequence[str] | None = None) -> int:
    """Two campaigns and their comparison; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", default="bracket")
    parser.add_argument("--episodes", type=int, default=4)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--count", type=int, default=10, help="workpieces a bin")
    parser.add_argument("--out", type=Path, default=Path("out/example"))
    args = parser.parse_args(words)

    folders = {1.0: args.out / "fast", 0.5: args.out / "slow"}
    campaigns = []
    for speed, folder in folders.items():
        scenario = load_scenario(args.scenario, [f"count={args.count}", f"carry.speed_scale={speed}"])
        campaign = Campaign.run(
            scenario, episodes=args.episodes, workers=args.workers, oracle=["perception"], out=folder
        )
        low, high = campaign.summary["cluster95"]
        picked = sum(a.success for a in campaign.attempts)
        print(f"speed {speed:g}: {picked} picks, 95 % interval {low:.3f} to {high:.3f}")
        print(f"  failures and no-picks: {dict(Counter(str(a.reason) for a in campaign.attempts if a.reason))}")
        campaigns.append(campaign)
    found = compare(*campaigns)
    print(f"changed: {', '.join(found.changed)}; pick success: {found.verdict}")
    return 0


if __name__ == "__main__":  # the worker processes of a campaign import this file
    raise SystemExit(main())
