"""Differences of two campaigns over the same episodes, B less A, with their 95 % intervals, and the verdict on each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from pickproof.scenarios.comparison.paired import Outcome
from pickproof.scenarios.statistics.intervals import Counts, difference_interval, ratio_difference_interval

Verdict = Literal["better", "worse", "no evidence"]


@dataclass(frozen=True)
class Difference:
    """A figure of the same episodes in two campaigns: B less A, with its 95 % interval."""

    a: float
    b: float
    difference: float
    interval95: tuple[float, float]

    def verdict(self, less_is_better: bool = False) -> Verdict:
        """What the interval says: it lies on one side of 0, or it gives no evidence."""
        low, high = self.interval95
        if low <= 0 <= high:
            return "no evidence"
        return "better" if (high < 0) == less_is_better else "worse"


def counts_of(side: Sequence[Outcome]) -> Counts:
    """Successes and attempts of each episode."""
    return [o.successes for o in side], [o.attempts for o in side]


def cleared_of(side: Sequence[Outcome]) -> Counts:
    """Workpieces picked and dropped of each episode."""
    return [o.picked for o in side], [o.dropped for o in side]


def difference_of(a: Counts, b: Counts) -> Difference:
    """The pooled rates of the same episodes, B less A."""
    first, second = (sum(s) / sum(m) for s, m in (a, b))
    return Difference(first, second, second - first, difference_interval(a, b))


def cycle_difference(a: Sequence[Outcome], b: Sequence[Outcome]) -> Difference | None:
    """Of the mean cycle of an attempt [s]; None where times were not recorded or there are fewer than two episodes."""
    return _ratio_difference(*(([o.cycle_s for o in side], [o.attempts for o in side]) for side in (a, b)))


def picks_per_hour_difference(a: Sequence[Outcome], b: Sequence[Outcome]) -> Difference | None:
    """Of successful picks an hour of cell time, no-picks included [1/h]; None as for the cycle."""
    sides = (([3600.0 * o.successes for o in s], [o.cycle_s + o.no_pick_s for o in s]) for s in (a, b))
    return _ratio_difference(*sides)


def _ratio_difference(
    a: tuple[Sequence[float], Sequence[float]], b: tuple[Sequence[float], Sequence[float]]
) -> Difference | None:
    if len(a[0]) < 2 or not all(sum(part) > 0 for side in (a, b) for part in side):
        return None
    first, second = (sum(n) / sum(d) for n, d in (a, b))
    return Difference(first, second, second - first, ratio_difference_interval(a, b))


def points(difference: float) -> str:
    """A difference of rates in percentage points, signed."""
    return f"{100 * difference:+.1f}"


def span(interval: Sequence[float]) -> str:
    """An interval of differences in percentage points."""
    return f"{points(interval[0])} to {points(interval[1])}"
