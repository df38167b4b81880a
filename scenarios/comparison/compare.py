"""`pickproof compare A B`: two campaigns over the same bins, paired by seed (docs/explanation/statistics.md)."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.special import ndtri

from pickproof.scenarios.comparison.difference import (
    Difference,
    Verdict,
    cleared_of,
    counts_of,
    cycle_difference,
    difference_of,
    picks_per_hour_difference,
)
from pickproof.scenarios.comparison.paired import (
    Outcome,
    changed_fields,
    changed_values,
    check_same_bins,
    outcomes,
    same_seeds,
)
from pickproof.scenarios.config.input_hashes import changed as changed_names
from pickproof.scenarios.results.records import AttemptRecord
from pickproof.scenarios.results.store import Store
from pickproof.scenarios.statistics.intervals import difference_variances, pair_interval

BOUND = 0.02
"""Difference of rates that is small enough not to matter, as the gate's margin."""
BEYOND = 100_000
"""Episodes beyond which a number is of no use."""
Pairs = tuple[list[Outcome], list[Outcome]]


@dataclass(frozen=True)
class FirstAttempts(Difference):
    """Pairs of first attempts in identical bins: how many only A, only B got right; exact McNemar p, two-sided."""

    only_a: int
    only_b: int
    both: int
    neither: int
    p: float


@dataclass(frozen=True)
class Comparison:
    """What two campaigns say about each other.

    Attributes:
        changed: dotted fields in which the scenarios differ, and `oracle`, `weights_hash`, `inputs.` and `versions.`
            where those do.
        differ: name of `changed` -> its values in A and in B.
        success, clearance: of whole episodes; None where the stop rules differ or nothing was tried.
        cycle, picks_per_hour: likewise, in [s] of an attempt and [1/h]; compute is measured on the machine that ran.
        verdicts: on each of these four; `verdict` is that of `basis`.
        reasons: failures and no-picks a record, by reason.
        basis: what the verdict stands on.
        more_to_show: episodes more that would show, with a chance of 90 %, a difference as large as the one seen.
        more_to_bound: episodes more that would bound the difference to `BOUND`, if it is none. None beyond reach.
    """

    episodes: int
    left_out: int
    changed: list[str]
    differ: dict[str, list[Any]]
    first_attempts: FirstAttempts
    success: Difference | None
    clearance: Difference | None
    cycle: Difference | None
    picks_per_hour: Difference | None
    verdicts: dict[str, Verdict]
    reasons: dict[str, Difference]
    basis: Literal["success", "first_attempts"]
    verdict: Verdict
    more_to_show: int | None
    more_to_bound: int | None


def compare(a: str | os.PathLike[str], b: str | os.PathLike[str]) -> Comparison:
    """Compare two campaigns, or the campaigns in two folders, over the episodes that ended in both.

    Raises:
        InputError: there is nothing in a folder, or the campaigns were not over the same bins.
    """
    a, b = Path(a), Path(b)
    with Store.read(a) as first, Store.read(b) as second:
        metas = first.meta(), second.meta()
        changed = changed_fields(metas[0]["scenario"], metas[1]["scenario"])
        check_same_bins(changed, b)
        records = first.attempts(large=False), second.attempts(large=False)
        known = outcomes(records[0], first.episodes()), outcomes(records[1], second.episodes())
        pairs = same_seeds(*known, b)
    whole = not any(field.startswith("stop.") for field in changed)
    made_with = {key: metas[1].get(key) for key in ("oracle", "weights_hash", "inputs", "versions")}
    changed += changed_names(metas[0], made_with)
    measures = _measures(pairs) if whole else dict.fromkeys(LESS_IS_BETTER)
    firsts = _first_attempts(*pairs)
    basis: Difference = measures["success"] or firsts
    variance = _variance(pairs, firsts, whole=measures["success"] is not None)
    return Comparison(
        episodes=len(pairs[0]),
        left_out=len({o.seed for side in known for o in side}) - len(pairs[0]),
        changed=changed,
        differ=changed_values(*metas, changed),
        first_attempts=firsts,
        **measures,
        verdicts={name: d.verdict(LESS_IS_BETTER[name]) for name, d in measures.items() if d is not None},
        reasons=_reasons(records, [o.seed for o in pairs[0]]),
        basis="success" if measures["success"] else "first_attempts",
        verdict=basis.verdict(),
        more_to_show=_more(variance, basis.difference, 0.9, len(pairs[0])),
        more_to_bound=_more(variance, BOUND, 0.5, len(pairs[0])),
    )


LESS_IS_BETTER = {"success": False, "clearance": False, "cycle": True, "picks_per_hour": False}
"""The measures of whole episodes."""


def _measures(pairs: Pairs) -> dict[str, Difference | None]:
    """Those of LESS_IS_BETTER; None where there is nothing to measure."""
    tried = all(any(o.attempts for o in side) for side in pairs)
    return {
        "success": difference_of(counts_of(pairs[0]), counts_of(pairs[1])) if tried else None,
        "clearance": difference_of(cleared_of(pairs[0]), cleared_of(pairs[1]))
        if any(o.dropped for o in pairs[0])
        else None,
        "cycle": cycle_difference(*pairs),
        "picks_per_hour": picks_per_hour_difference(*pairs),
    }


def _first_attempts(a: Sequence[Outcome], b: Sequence[Outcome]) -> FirstAttempts:
    from scipy.stats import binomtest  # takes a second to import

    n, pairs = len(a), Counter((x.first, y.first) for x, y in zip(a, b, strict=True))
    only_a, only_b, both = pairs[True, False], pairs[False, True], pairs[True, True]
    p = binomtest(only_a, only_a + only_b).pvalue if only_a + only_b else 1.0
    rates = (both + only_a) / n, (both + only_b) / n
    return FirstAttempts(
        *rates,
        (only_b - only_a) / n,
        pair_interval(only_b, only_a, n),
        only_a=only_a,
        only_b=only_b,
        both=both,
        neither=pairs[False, False],
        p=float(p),
    )


def _reasons(
    records: tuple[Sequence[AttemptRecord], Sequence[AttemptRecord]], seeds: Sequence[int]
) -> dict[str, Difference]:
    """Of the attempts and no-picks of both, most frequent first."""
    index = {seed: i for i, seed in enumerate(seeds)}
    totals = np.zeros((2, len(seeds)), dtype=int)
    found: dict[str, np.ndarray] = {}
    for side, of_side in enumerate(records):
        for a in of_side:
            if a.seed in index:
                totals[side, index[a.seed]] += 1
                if a.reason:
                    found.setdefault(str(a.reason), np.zeros_like(totals))[side, index[a.seed]] += 1
    order = sorted(found, key=lambda reason: (-found[reason].sum(), reason))
    return {r: difference_of(*((found[r][i].tolist(), totals[i].tolist()) for i in (0, 1))) for r in order}


def _variance(pairs: Pairs, firsts: FirstAttempts, whole: bool) -> float:
    """Of the difference of one episode, at least as if one pair more had differed."""
    n = len(pairs[0])
    if not whole:
        return (firsts.only_a + firsts.only_b + 1) / (n + 1) - firsts.difference**2
    if n < 2:
        return 1.0
    sides = [tuple(np.array(c)[None] for c in counts_of(side)) for side in pairs]
    return float(difference_variances(sides[0], sides[1])[0]) * n  # type: ignore[arg-type]


def _more(variance: float, difference: float, power: float, have: int) -> int | None:
    """Episodes that are missing for a two-sided test at 5 % to find a difference."""
    if difference == 0:
        return None
    need = ceil((ndtri(0.975) + ndtri(power)) ** 2 * variance / difference**2)
    return None if need > BEYOND else max(0, need - have)
