"""What `pickproof tune` is asked to do: the plan of a search, and the constants of its stages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pickproof.grasping.grasp_points import GraspPoint
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.tuning.search_space import Field, Reach

HOLDOUT = 1_000_000
"""Added to the seed for the bins of the final comparison, which the search never sees."""
Tell = Callable[[str, int, int], None]
"""Called as the work goes on: stage, done, of how many (0 where that is not known)."""


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
