"""What `pickproof tune` is asked to do, and what runs its trials and episodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pickproof.grasping.grasp_points import GraspPoint
from pickproof.scenarios.campaign.job import Runner
from pickproof.scenarios.campaign.parallel_map import Map
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.tuning.grasp_objective import GraspTask, try_point
from pickproof.scenarios.tuning.grasp_space import Reach
from pickproof.scenarios.tuning.optimizer import Told
from pickproof.scenarios.tuning.scenario_fields import Field

HOLDOUT = 1_000_000
"""Added to the seed for the bins of the final comparison, which the search never sees."""
Tell = Callable[[str, int, int], None]
"""Called as the work goes on: stage, done, of how many (0 where that is not known)."""
Deadline = Callable[[], bool]
"""Asked between steps: whether there is time for another one."""


@dataclass(frozen=True)
class Plan:
    """What is tuned, and with how much effort.

    Attributes:
        scenario: as it is, with the seed of bins and search; `points` are those of its `table`, made for `gripper`
            unless they say otherwise, `names` those of them that may be moved, `reach` how far.
        fields: numbers of the scenario that may change too.
        generations: of each grasp; rounds: of whole cells; episodes: of a candidate at most, `block` at a time.
        holdout: unseen episodes of the final comparison.
        p95: errors of perception by direction, None for a default.
        budget_s: [s] after which stages end early, None for no limit.
    """

    scenario: Scenario
    table: Path
    gripper: str
    points: tuple[GraspPoint, ...]
    names: tuple[str, ...]
    fields: tuple[Field, ...]
    oracle: frozenset[str]
    out: Path
    reach: Reach
    generations: int = 8
    rounds: int = 4
    episodes: int = 8
    block: int = 2
    holdout: int = 20
    p95: dict[str, float] | None = None
    budget_s: float | None = None
    workers: int = 1
    ray: str | None = None
    command: str = ""


def _tell_nobody(stage: str, done: int, total: int) -> None:
    return None


@dataclass(frozen=True)
class Runners:
    """What a search runs on.

    Attributes:
        map: as the built-in `map`, over the trials of a generation.
        episode: runs one episode.
        trial: tries one grasp on a lone workpiece.
        tell: called as the work goes on.
    """

    map: Map
    episode: Runner
    trial: Callable[[GraspTask], Told] = try_point
    tell: Tell = _tell_nobody
