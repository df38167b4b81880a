"""`pickproof compare A B`: two campaigns over the same bins, paired by seed; docs/statistics.md says how."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.special import ndtri

from pickproof.scenarios.comparison.paired import Outcome, changed_fields, check_same_bins, outcomes, same_seeds
from pickproof.scenarios.config.input_hashes import changed as changed_names
from pickproof.scenarios.results.records import AttemptRecord
from pickproof.scenarios.results.store import Store
from pickproof.scenarios.results.summary import counted, percent
from pickproof.scenarios.statistics.intervals import Counts, difference_interval, difference_variances, pair_interval

BOUND = 0.02
"""Difference of rates that is small enough not to matter, as the gate's margin."""
BEYOND = 100_000
"""Episodes beyond which a number is of no use."""
Verdict = Literal["better", "worse", "no evidence"]


@dataclass(frozen=True)
class Difference:
    """Two rates of the same episodes: B less A, with its 95 % interval."""

    a: float
    b: float
    difference: float
    interval95: tuple[float, float]


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
        success, clearance: of whole episodes; None where the stop rules differ or nothing was tried.
        reasons: failures and no-picks a record, by reason.
        basis: what the verdict stands on.
        more_to_show: episodes more that would show, with a chance of 90 %, a difference as large as the one seen.
        more_to_bound: episodes more that would bound the difference to `BOUND`, if it is none. None beyond reach.
    """

    episodes: int
    left_out: int
    changed: list[str]
    first_attempts: FirstAttempts
    success: Difference | None
    clearance: Difference | None
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
    stop = [field for field in changed if field.startswith("stop.")]
    made_with = {key: metas[1].get(key) for key in ("oracle", "weights_hash", "inputs", "versions")}
    changed += changed_names(metas[0], made_with)
    tried = all(any(o.attempts for o in side) for side in pairs)
    success = difference_of(counts_of(pairs[0]), counts_of(pairs[1])) if tried and not stop else None
    clearance = None
    if not stop and any(o.dropped for o in pairs[0]):
        clearance = difference_of(cleared_of(pairs[0]), cleared_of(pairs[1]))
    firsts = _first_attempts(*pairs)
    basis: Difference = success or firsts
    low, high = basis.interval95
    verdict: Verdict = "worse" if high < 0 else "better" if low > 0 else "no evidence"
    variance = _variance(pairs, firsts, whole=success is not None)
    return Comparison(
        episodes=len(pairs[0]),
        left_out=len({o.seed for side in known for o in side}) - len(pairs[0]),
        changed=changed,
        first_attempts=firsts,
        success=success,
        clearance=clearance,
        reasons=_reasons(records, [o.seed for o in pairs[0]]),
        basis="success" if success else "first_attempts",
        verdict=verdict,
        more_to_show=_more(variance, basis.difference, 0.9, len(pairs[0])),
        more_to_bound=_more(variance, BOUND, 0.5, len(pairs[0])),
    )


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


def _variance(pairs: tuple[list[Outcome], list[Outcome]], firsts: FirstAttempts, whole: bool) -> float:
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


def verdict_line(c: Comparison) -> str:
    """The verdict in a sentence or two."""
    d: Difference = c.success or c.first_attempts
    what = "pick success" if c.basis == "success" else "success of first attempts"
    line = f"{c.verdict}: {what} {percent(d.a)} -> {percent(d.b)}, {points(d.difference)} [{span(d.interval95)}]"
    line += f" points over {counted(c.episodes, 'paired episode')}"
    if c.verdict != "no evidence":
        return line
    show = "no number of episodes within reason" if c.more_to_show is None else f"about {c.more_to_show} more"
    bound = "more than is reasonable" if c.more_to_bound is None else f"about {c.more_to_bound} more"
    return f"{line}; to show a difference of the size seen: {show}; to bound it to {100 * BOUND:.0f} points: {bound}"


def points(difference: float) -> str:
    """A difference of rates in percentage points, signed."""
    return f"{100 * difference:+.1f}"


def span(interval: Sequence[float]) -> str:
    """An interval of differences in percentage points."""
    return f"{points(interval[0])} to {points(interval[1])}"


def print_comparison(console: Console, c: Comparison, a: Path, b: Path) -> None:
    """The table and the verdict."""
    table = Table(title=f"A {a}\nB {b}\n{counted(c.episodes, 'paired episode')}", title_justify="left")
    for column in ("", "A", "B", "B - A in points", "95 %"):
        table.add_column(column, justify="left" if not column else "right")
    for name, d in (("pick success", c.success), ("clearance", c.clearance), ("first attempts", c.first_attempts)):
        if d is not None:
            table.add_row(name, percent(d.a), percent(d.b), points(d.difference), span(d.interval95))
    for reason, d in c.reasons.items():
        table.add_row(f"  {reason}", percent(d.a), percent(d.b), points(d.difference), span(d.interval95))
    console.print(table)
    f = c.first_attempts
    console.print(
        f"first attempts in identical bins: {f.both} both, {f.only_a} only A, {f.only_b} only B, {f.neither} neither "
        f"(McNemar, exact: p = {f.p:.2g})",
        soft_wrap=True,
    )
    if c.success is None:
        console.print("whole episodes are not compared: the stop rules differ, or one side never moved the arm")
    if c.left_out:
        console.print(f"left out: {c.left_out} episodes that ended in one of the two only")
    console.print(f"differ: {', '.join(c.changed) or 'nothing that is recorded'}", soft_wrap=True, highlight=False)
    console.print(f"[bold]{verdict_line(c)}[/]", soft_wrap=True, highlight=False)
