"""An episode without physics in which each stage costs a known share of the picks unless its oracle stands in."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pickproof.scenarios.campaign.job import Job
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord

COSTS = {"perception": 0.02, "grasp": 0.25, "motion": 0.04}


def run_episode(job: Job, on_attempt: Callable[[AttemptRecord], None]) -> EpisodeRecord:
    """`scenario.count` attempts; the luck of each is that of the seed, whatever the oracles."""
    scenario, seed = job.scenario, job.seed
    luck = np.random.default_rng(seed).random(scenario.count)
    chance = 1.0 - sum(cost for stage, cost in COSTS.items() if stage not in job.oracle)
    for i, draw in enumerate(luck):
        success = bool(draw < chance)
        on_attempt(AttemptRecord(seed, i, True, success, "" if success else "slipped", scenario.count, 1))
    return EpisodeRecord(seed, scenario.count, int((luck < chance).sum()), "stopped", scenario.count, 0.0)
