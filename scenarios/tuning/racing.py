"""The second stage of `pickproof tune`: candidates race over the same bins, and losers leave early."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from pickproof.scenarios.comparison.paired import Outcome
from pickproof.scenarios.statistics.intervals import Counts, difference_interval

K = TypeVar("K", bound=Hashable)


@dataclass(frozen=True)
class Finish:
    """How a candidate left the race.

    Attributes:
        episodes: that it ran; rate: `counts_of_all` over them, pooled.
        gain: of the rate over the reference in the same episodes; interval95: of the gain.
        dropped: clearly below the best before the race ended.
    """

    episodes: int
    rate: float
    gain: float
    interval95: tuple[float, float]
    dropped: bool


def counts_of_all(side: Sequence[Outcome]) -> Counts:
    """Of each episode, workpieces picked out of workpieces dropped and failed attempts.

    Neither a cell that never moves nor one that tries until something comes up looks good by it.
    """
    return [o.picked for o in side], [o.dropped + o.attempts - o.successes for o in side]


def pooled(side: Sequence[Outcome]) -> float:
    """`counts_of_all` as one rate."""
    good, all_ = counts_of_all(side)
    return sum(good) / sum(all_) if sum(all_) else 0.0


def race(
    candidates: Sequence[K],
    reference: K,
    outcomes: Callable[[K, int], Sequence[Outcome]],
    block: int,
    episodes: int,
    go_on: Callable[[], bool] = lambda: True,
) -> dict[K, Finish]:
    """Race candidates over `episodes` bins, `block` more at a time.

    After each block every candidate that is below the best one by more than the 95 % interval of their paired
    difference is dropped, and the race ends where one is left that is as clearly above the reference. That is looked at
    many times and holds for no claim; unseen bins decide in the end.

    Args:
        outcomes: (candidate, n) -> its first n episodes, in order of seed; called again with larger n.
        reference: is run as long as any other, so that every gain is over the same bins.
        go_on: asked after each block; false ends the race early.
    """
    ran: dict[K, Sequence[Outcome]] = {}
    alive = list(dict.fromkeys(candidates))
    dropped: set[K] = set()
    for n in [*range(block, episodes, block), episodes]:
        for key in dict.fromkeys([reference, *alive]):
            ran[key] = outcomes(key, n)
        best = max(dict.fromkeys([reference, *alive]), key=lambda k: pooled(ran[k]))
        for key in list(alive):
            if clear_of(ran[key], ran[best]):
                alive.remove(key)
                dropped.add(key)
        if not alive or (len(alive) == 1 and clear_of(ran[reference], ran[alive[0]])) or not go_on():
            break
    return {key: _finish(ran[reference], ran[key], key in dropped) for key in dict.fromkeys(candidates)}


def clear_of(below: Sequence[Outcome], above: Sequence[Outcome]) -> bool:
    """Whether the 95 % interval of the paired difference of `counts_of_all` lies above zero."""
    return difference_interval(counts_of_all(below), counts_of_all(above))[0] > 0


def _finish(reference: Sequence[Outcome], own: Sequence[Outcome], dropped: bool) -> Finish:
    same = reference[: len(own)]
    gain = pooled(own) - pooled(same)
    bounds = difference_interval(counts_of_all(same), counts_of_all(own)) if own is not reference else (0.0, 0.0)
    return Finish(len(own), pooled(own), gain, bounds, dropped)
