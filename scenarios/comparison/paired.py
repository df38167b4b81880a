"""Two campaigns over the same bins: what is compared of an episode, and which campaigns can be compared."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pickproof.cell.errors import InputError
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord

Measure = Literal["first_attempt", "success", "clearance"]
MEASURES: tuple[Measure, ...] = ("first_attempt", "success", "clearance")
BIN_FIELDS = ("workpiece", "count", "source_bin", "table", "physics")
"""Fields of a scenario that decide how a seed fills the bin."""


@dataclass(frozen=True)
class Outcome:
    """What a finished episode came to.

    Attributes:
        dropped, picked: workpieces dropped into the bin, and picked of them.
        attempts, successes: of the attempts in which the arm moved.
        first: the first image of the freshly filled bin led to a successful pick. A no-pick is none.
        cycle_s: of all attempts together; no_pick_s: sensing and compute of the no-picks [s]. 0 where not recorded.
    """

    seed: int
    dropped: int
    picked: int
    attempts: int
    successes: int
    first: bool
    cycle_s: float = 0.0
    no_pick_s: float = 0.0

    def value(self, measure: Measure) -> float:
        """In [0, 1]. An episode in which the arm never moved has a success rate of 0, an empty bin is cleared."""
        if measure == "first_attempt":
            return float(self.first)
        if measure == "success":
            return self.successes / self.attempts if self.attempts else 0.0
        return self.picked / self.dropped if self.dropped else 1.0


def outcomes(attempts: Sequence[AttemptRecord], episodes: Sequence[EpisodeRecord]) -> list[Outcome]:
    """Of the episodes that ended."""
    of_seed: dict[int, list[AttemptRecord]] = {e.seed: [] for e in episodes}
    for a in attempts:
        if a.seed in of_seed:
            of_seed[a.seed].append(a)
    return [_outcome(e, of_seed[e.seed]) for e in {e.seed: e for e in episodes}.values()]


def _outcome(episode: EpisodeRecord, attempts: Sequence[AttemptRecord]) -> Outcome:
    return Outcome(
        seed=episode.seed,
        dropped=episode.parts_dropped,
        picked=episode.parts_picked,
        attempts=sum(a.moved for a in attempts),
        successes=sum(a.success for a in attempts),
        first=any(a.attempt == 0 and a.success for a in attempts),
        cycle_s=sum(a.cycle_s for a in attempts if a.moved),
        no_pick_s=sum(a.cycle_s for a in attempts if not a.moved),
    )


def changed_values(first: Mapping[str, Any], second: Mapping[str, Any], names: Sequence[str]) -> dict[str, list[Any]]:
    """Field -> its value in the first and in the second campaign, of those that differ.

    Args:
        first, second: `meta` of the campaigns.
        names: dotted fields of the scenario, and `oracle`, `inputs.mesh` and the like, as `Comparison.changed`.
    """
    sides = []
    for meta in (first, second):
        scenario = meta["scenario"]
        top = _leaves({key: value for key, value in meta.items() if key != "scenario"})
        sides.append(top | dict(meta) | _leaves(json.loads(scenario) if isinstance(scenario, str) else scenario))
    return {name: [side.get(name) for side in sides] for name in names}


def changed_fields(first: str | Mapping[str, Any], second: str | Mapping[str, Any]) -> list[str]:
    """Dotted fields in which two effective scenarios differ, `name` and `seed` left out."""
    a, b = (_leaves(json.loads(s) if isinstance(s, str) else s) for s in (first, second))
    return sorted(f for f in a.keys() | b.keys() if a.get(f) != b.get(f) and f not in ("name", "seed"))


def check_same_bins(changed: Sequence[str], file: str | Path) -> None:
    """Refuse campaigns whose bins differ.

    Raises:
        InputError: names the fields that decide how the bin is filled and differ.
    """
    different = [f for f in changed if f.partition(".")[0] in BIN_FIELDS]
    if different:
        raise InputError(
            file, ", ".join(different), "other values", "the same bins in both: these fields decide how they are filled"
        )


def same_seeds(
    first: Sequence[Outcome], second: Sequence[Outcome], file: str | Path
) -> tuple[list[Outcome], list[Outcome]]:
    """The episodes that both have, in order of seed.

    Raises:
        InputError: they share no seed, or a seed dropped another number of workpieces.
    """
    a, b = ({o.seed: o for o in side} for side in (first, second))
    seeds = sorted(a.keys() & b.keys())
    if not seeds:
        raise InputError(
            file, "seeds", _span(list(b)), f"finished episodes at the seeds of the other ({_span(list(a))})"
        )
    for seed in seeds:
        if a[seed].dropped != b[seed].dropped:
            raise InputError(
                file, f"workpieces in the bin of seed {seed}", b[seed].dropped, f"{a[seed].dropped} as in the other"
            )
    return [a[s] for s in seeds], [b[s] for s in seeds]


def _span(seeds: Sequence[int]) -> str:
    return f"{min(seeds)} to {max(seeds)}" if seeds else "none"


def _leaves(data: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    leaves: dict[str, Any] = {}
    for key, value in data.items():
        inner = _leaves(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {prefix + key: value}
        leaves |= inner
    return leaves
