"""`pickproof benchmark gate`: errors of gate and intervals, by simulation (docs/measurements/statistics.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.special import expit
from scipy.stats import beta

from pickproof.cell.frames import Array
from pickproof.scenarios.statistics.intervals import cluster_intervals, difference_intervals, wilson
from pickproof.scenarios.statistics.sequential_test import Rule, decide

EPISODES = 400
"""Of a simulated gate at most."""
PICKS = (20, 26)
"""Attempts of an episode, from and below; whole episodes of the shipped scenario have about 25."""
_CHUNK = 250


@dataclass(frozen=True)
class GateCase:
    """Gates between two systems.

    Attributes:
        first, second: rates of baseline and candidate.
        icc: correlation of the picks of one bin; None for first attempts, one an episode.
        discordance: share of first attempts, or of episodes, on which the two fall apart.
    """

    name: str
    first: float
    second: float
    icc: float | None
    discordance: float


GATES = (
    GateCase("equal, first attempts", 0.95, 0.95, None, 0.06),
    GateCase("equal, first attempts, half fall apart", 0.5, 0.5, None, 0.5),
    GateCase("equal, whole episodes", 0.95, 0.95, 0.05, 1.0),
    GateCase("equal, whole episodes, alike within a bin", 0.95, 0.95, 0.2, 1.0),
    GateCase("unchanged", 0.95, 0.95, None, 0.0),
    GateCase("5 points worse, first attempts", 0.95, 0.90, None, 0.06),
    GateCase("5 points worse, whole episodes", 0.95, 0.90, 0.05, 1.0),
    GateCase("2 points worse (the margin), first attempts", 0.95, 0.93, None, 0.06),
    GateCase("2 points worse (the margin), whole episodes", 0.95, 0.93, 0.2, 1.0),
)
INTERVALS = [(k, p, icc) for k in (3, 10, 30) for p in (0.8, 0.95, 0.99) for icc in (0.05, 0.2)]
DIFFERENCES = [
    (k, p, q, icc)
    for k in (5, 10, 30)
    for p, q in ((0.8, 0.8), (0.95, 0.95), (0.95, 0.9), (0.99, 0.97))
    for icc in (0.05, 0.1, 0.2)
]
_LOGITS = np.linspace(-60, 60, 4001)  # where the beta distribution is tabulated: it is steep at both ends


def simulate_gate(case: GateCase, campaigns: int, rng: np.random.Generator, rule: Rule) -> dict[str, Any]:
    """Shares of decisions under continuous looking, and the mean number of paired episodes."""
    kinds, stops = [], []
    for begin in range(0, campaigns, _CHUNK):
        size = (min(_CHUNK, campaigns - begin), EPISODES)
        kind, stop = decide(_pairs(case, size, rng), rule)
        kinds.append(kind)
        stops.append(stop)
    kind, stop = np.concatenate(kinds), np.concatenate(stops)
    shares = {name: float(np.mean(kind == i)) for i, name in enumerate(("undecided", "worse", "passed"))}
    return {
        **asdict(case),
        **shares,
        "episodes_mean": float(stop.mean()),
        "episodes_p90": float(np.quantile(stop, 0.9)),
    }


def _pairs(case: GateCase, size: tuple[int, int], rng: np.random.Generator) -> Array:
    """Differences, candidate less baseline, of each gate and episode."""
    if case.icc is None:  # rates differ by what is lost less what is gained
        lost = (case.discordance + case.first - case.second) / 2
        u = rng.random(size)
        return np.where(u < lost, -1.0, np.where(u < case.discordance, 1.0, 0.0))
    (s1, m1), (s2, m2) = draw_pair(case.first, case.second, case.icc, size, rng)
    return s2 / m2 - s1 / m1


def draw(rate: float, icc: float, size: tuple[int, int], rng: np.random.Generator) -> tuple[Array, Array]:
    """Successes and attempts of beta-binomial episodes."""
    return draw_pair(rate, rate, icc, size, rng)[0]


def draw_pair(
    first: float, second: float, icc: float, size: tuple[int, int], rng: np.random.Generator
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Two systems in the same bins: a bin that is hard for one is as hard, by rank, for the other."""
    rank = rng.random(size)

    def side(rate: float) -> tuple[Array, Array]:
        m, chance = rng.integers(*PICKS, size), np.full(size, rate)
        if icc:
            spread = (1 - icc) / icc
            below = beta.cdf(expit(_LOGITS), rate * spread, (1 - rate) * spread)
            chance = expit(np.interp(rank, below, _LOGITS))
        return np.asarray(rng.binomial(m, chance)), np.asarray(m)

    return side(first), side(second)


def coverage(bounds: Array, truth: float) -> float:
    """Share of intervals, (n, 2), that hold the truth."""
    return float(np.mean((bounds[:, 0] <= truth + 1e-12) & (truth - 1e-12 <= bounds[:, 1])))


def bootstrap_intervals(first: tuple[Array, Array], second: tuple[Array, Array], rng: np.random.Generator) -> Array:
    """Percentile intervals of a cluster bootstrap, paired by episode, of 1,000 resamples: for comparison only."""
    k = first[0].shape[1]
    weights = rng.multinomial(k, np.full(k, 1 / k), 1000).T
    rates = [(s @ weights) / (m @ weights) for s, m in (first, second)]
    return np.quantile(rates[1] - rates[0], (0.025, 0.975), axis=1).T


def interval_coverage(campaigns: int, rng: np.random.Generator) -> list[dict[str, float]]:
    """Of `cluster_interval` and of Wilson's."""
    rows = []
    for k, rate, icc in INTERVALS:
        s, m = draw(rate, icc, (campaigns, k), rng)
        plain = np.array([wilson(a, n) for a, n in zip(s.sum(1), m.sum(1), strict=True)])
        ours = cluster_intervals(s, m)
        row = {
            "episodes": k,
            "rate": rate,
            "icc": icc,
            "cluster": coverage(ours, rate),
            "wilson": coverage(plain, rate),
        }
        rows.append(row | {"width": float(np.mean(ours[:, 1] - ours[:, 0]))})
    return rows


def difference_coverage(campaigns: int, rng: np.random.Generator) -> list[dict[str, float]]:
    """Of `difference_interval` and of the percentile cluster bootstrap."""
    rows = []
    for k, first, second, icc in DIFFERENCES:
        pair = draw_pair(first, second, icc, (campaigns, k), rng)
        ours, truth = difference_intervals(*pair), second - first
        few = tuple((s[:300], m[:300]) for s, m in pair)
        row = {"episodes": k, "first": first, "second": second, "icc": icc, "difference": coverage(ours, truth)}
        row["bootstrap"] = coverage(bootstrap_intervals(few[0], few[1], rng), truth)
        rows.append(row | {"width": float(np.mean(ours[:, 1] - ours[:, 0]))})
    return rows


def calibrate(campaigns: int, seed: int) -> dict[str, Any]:
    """All tables; intervals are drawn two fifths as often as gates: they cost more."""
    rng, rule, fewer = np.random.default_rng(seed), Rule(), max(1, campaigns * 2 // 5)
    return {
        "campaigns": campaigns,
        "rule": asdict(rule),
        "gates": [simulate_gate(case, campaigns, rng, rule) for case in GATES],
        "intervals": interval_coverage(fewer, rng),
        "differences": difference_coverage(fewer, rng),
    }


def print_tables(console: Console, found: dict[str, Any]) -> None:
    """The tables of docs/measurements/statistics.md."""
    console.print(f"{found['campaigns']} gates a row, looked at after every episode, at most {EPISODES} episodes")
    _table(console, found["gates"], ("name", "worse", "passed", "undecided", "episodes_mean", "episodes_p90"))
    _table(console, found["intervals"], ("episodes", "rate", "icc", "cluster", "wilson", "width"))
    _table(console, found["differences"], ("episodes", "first", "second", "icc", "difference", "bootstrap", "width"))
    for name, table in (("cluster", "intervals"), ("difference", "differences")):
        least = min(found[table], key=lambda row: row[name])
        console.print(f"least coverage of `{name}_interval`: {least[name]:.4f} at {least}", soft_wrap=True)


def _table(console: Console, rows: Sequence[dict[str, Any]], columns: Sequence[str]) -> None:
    table = Table()
    for column in columns:
        table.add_column(column, justify="left" if column == "name" else "right")
    for row in rows:
        table.add_row(*(f"{row[c]:.4g}" if isinstance(row[c], float) else str(row[c]) for c in columns))
    console.print(table)
