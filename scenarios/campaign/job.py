"""The job of a worker: one episode, with all inputs of its records and the data to keep with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord
from pickproof.scenarios.results.replay_selection import Keep


@dataclass(frozen=True)
class Job:
    """One episode to be run.

    Attributes:
        seed: of the bin's filling and of all noise.
        oracle: stages replaced by ground truth.
        pictures: whether attempts carry their pictures.
        keep: which attempts are stored for replay, and where; None for none.
    """

    scenario: Scenario
    seed: int
    oracle: frozenset[str] = frozenset()
    pictures: bool = False
    keep: Keep | None = None


Runner = Callable[[Job, Callable[[AttemptRecord], None]], EpisodeRecord]
"""(job, on_attempt) -> how the episode ended; must be importable by name in a new process."""
