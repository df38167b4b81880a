"""Five small campaigns and their record hashes, which every machine must reproduce under the pinned versions.

`python -m tests.benchmarks.golden` computes them anew and writes golden.json. Do so only for a change that is meant to
change picks, and say why in the CHANGELOG.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

from pickproof.scenarios.campaign.episode import run_episode
from pickproof.scenarios.campaign.job import Job
from pickproof.scenarios.config.input_hashes import versions
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.results.record_hash import record_hash
from pickproof.scenarios.results.records import AttemptRecord

FILE = Path(__file__).with_name("golden.json")
GRID = Path(__file__).resolve().parents[1] / "scenarios" / "placing" / "grid.yaml"


@dataclass(frozen=True)
class Golden:
    """One episode of a scenario with few workpieces."""

    scenario: str
    count: int
    oracle: frozenset[str] = frozenset()

    def record_hash(self) -> str:
        """Of the episode, run in this process."""
        scenario = load_scenario(self.scenario, [f"count={self.count}"])
        attempts: list[AttemptRecord] = []
        end = run_episode(Job(scenario, scenario.seed, self.oracle), attempts.append)
        return record_hash(attempts, [end])


_PERFECT = frozenset({"perception"})
CAMPAIGNS = {
    "bracket": Golden("bracket", 3, _PERFECT),
    "bracket-ps6d": Golden("bracket", 3),
    "shaft": Golden("gear_shaft", 2, _PERFECT),
    "cups": Golden("ps6d_23", 2, _PERFECT),
    "pattern": Golden(str(GRID), 3, _PERFECT),
}


def software() -> dict[str, str]:
    """Versions of the libraries that decide the results; pickproof's own code is what the hashes are to judge."""
    return {name: version for name, version in versions().items() if name not in ("pickproof", "code")}


def main() -> int:
    """Write the hashes of this machine."""
    hashes = {}
    for name, campaign in CAMPAIGNS.items():
        hashes[name] = campaign.record_hash()
        print(name, hashes[name], flush=True)
    FILE.write_text(json.dumps({"hashes": hashes, "versions": software()}, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
