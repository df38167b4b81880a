"""An episode without physics whose rate is set by the scenario, importable by name in worker processes.

`carry.speed_scale` is the chance of success. A bin's own difficulty and each attempt's luck are drawn from the seed, so
two scenarios meet the same bins, and a lower chance fails where the higher one did and in some places more.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pickproof.cell.errors import SimulationError
from pickproof.scenarios.campaign.job import Job
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord


def run_episode(job: Job, on_attempt: Callable[[AttemptRecord], None]) -> EpisodeRecord:
    scenario, seed = job.scenario, job.seed
    if scenario.gripper == "broken":
        raise SimulationError("a workpiece is at infinity")
    luck = np.random.default_rng((seed, 1)).random(scenario.stop.attempt_limit)
    left, attempt = scenario.count, 0
    while left and attempt < scenario.stop.attempt_limit:
        success = bool(luck[attempt] < scenario.carry.speed_scale)
        reason = "" if success else ("slipped" if luck[attempt] < 0.97 else "missed")
        on_attempt(AttemptRecord(seed, attempt, True, success, reason, left, 1))
        left -= success
        attempt += 1
    return EpisodeRecord(seed, scenario.count, scenario.count - left, "stopped" if left else "cleared", attempt, 0.0)


def write_campaign(out, scenario: Scenario, seeds: range, **meta) -> None:
    """A results file of such episodes, made in this process."""
    from pickproof.scenarios.config.scenario import scenario_hash, scenario_json
    from pickproof.scenarios.results.store import Store

    values = {"scenario": scenario_json(scenario), "scenario_hash": scenario_hash(scenario), "seed": seeds.start}
    values |= {"episodes": len(seeds), "oracle": [], "weights_hash": "", "versions": {}, "command": "", "wall_s": 0.0}
    with Store.create(out, values | meta) as store:
        for seed in seeds:
            store.add_episode(run_episode(Job(scenario, seed), store.add_attempt))
