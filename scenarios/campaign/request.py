"""What is asked of a campaign: one frozen request in place of a long list of arguments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pickproof.scenarios.campaign.executor import STALL_S
from pickproof.scenarios.campaign.job import Job, Runner
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.results.replay_selection import Keep


@dataclass(frozen=True, kw_only=True)
class CampaignRequest:
    """Episodes of one scenario at seeds `seed`, `seed` + 1, ..., where their results go, and with what effort they run.

    Attributes:
        scenario: the cell and its job; its own `seed` is not used.
        episodes: how many, those included that `out` holds already.
        seed: of the first episode.
        out: folder of the results; it is made where it is missing.
        runner: runs one episode; it is sent to the workers by its import path.
        workers: episodes at a time; with `ray`, 0 for all processors of the cluster.
        oracle: stages replaced by ground truth: `perception`, `grasp`, `motion`.
        weights_hash: of the network that perceives, empty for none.
        command: the command line, for the report.
        resume: `out` holds results of the same campaign, which is continued.
        pictures: whether attempts keep pictures.
        keep: which attempts are kept to look at again; None for none.
        stall_s: [s] without a word from an episode after which it counts as hung.
        expected_s: seed -> time [s] that its episode takes, where known: the longest are begun first.
        ray: address of a Ray cluster, or `local` to start one here; None for worker processes.
    """

    scenario: Scenario
    episodes: int
    seed: int
    out: Path
    runner: Runner
    workers: int = 1
    oracle: frozenset[str] = frozenset()
    weights_hash: str = ""
    command: str = ""
    resume: bool = False
    pictures: bool = True
    keep: Keep | None = None
    stall_s: float = STALL_S
    expected_s: Mapping[int, float] = field(default_factory=dict)
    ray: str | None = None

    @property
    def seeds(self) -> range:
        """Of all episodes."""
        return range(self.seed, self.seed + self.episodes)

    @property
    def first_job(self) -> Job:
        """The job of the first episode; the others differ by their seed."""
        return Job(self.scenario, self.seed, self.oracle, self.pictures, self.keep)
