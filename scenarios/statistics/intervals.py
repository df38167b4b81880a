"""Intervals for a pick success rate and for the difference of two (docs/explanation/statistics.md).

Picks of one bin are not independent: a heap that is hard to pick is hard more than once. `wilson` ignores that,
`cluster_interval` does not. Both stay inside [0, 1] and neither has width 0, whatever the counts.

`results/summary.py` gives both for a campaign's rate. A class of attempts in a report has Wilson's, and a comparison of
two campaigns has `difference_interval`.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np
from scipy.optimize import brentq
from scipy.special import betaln, expit, logit, ndtri, stdtrit  # scipy.stats, which calls them, loads slowly

from pickproof.cell.frames import Array

LOWER, UPPER = 0.025, 0.975
"""Quantiles of every interval here. `Z95`, and `wilson95` and `cluster95` in summary.json, are named after them."""
Z95 = float(ndtri(UPPER))
ICC_PRIOR = 4.0
"""Correlation r within a bin has the prior density 4 (1 - r)^3, of mean 1/5."""
UNSEEN_FAILURES, UNSEEN_ICC = 4.0, 0.05
"""Failures that two campaigns together might have had more, and how those are correlated within a bin."""
Counts = tuple[Sequence[int], Sequence[int]]
"""Successes and attempts of each episode."""

_ICC = 1 - (1 - (np.arange(16) + 0.5) / 16) ** (1 / ICC_PRIOR)  # nodes of equal prior weight
_RATES = 160  # nodes
_WIDE = 6.0  # quantile beyond which there is no posterior mass to speak of


def wilson(successes: float, n: float, z: float = Z95) -> tuple[float, float]:
    """Score interval of a binomial rate (Wilson 1927, eq. as in Brown, Cai, DasGupta 2001); (0, 1) for n = 0."""
    if n <= 0:
        return (0.0, 1.0)
    p = successes / n
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return (0.0 if successes == 0 else centre - half, 1.0 if successes == n else centre + half)


def cluster_interval(successes: Sequence[int], attempts: Sequence[int]) -> tuple[float, float]:
    """95 % interval of the pooled rate that respects clustering by episode.

    The hull of Wilson's interval and the equal-tailed posterior interval of the mean of a beta-binomial
    distribution, with Jeffreys' prior for the mean and `ICC_PRIOR` for the correlation, which few episodes or
    few failures cannot show. In simulation it covers where a cluster bootstrap, percentile or BCa, does not
    (docs/explanation/statistics.md).

    Args:
        successes, attempts: of each episode; episodes without an attempt say nothing.
    """
    pairs = [(s, m) for s, m in zip(successes, attempts, strict=True) if m > 0]
    if not pairs:
        return (0.0, 1.0)
    s, m = np.array(pairs).T
    low, high = cluster_intervals(s[None], m[None])[0]
    return (float(low), float(high))


def cluster_intervals(successes: Array, attempts: Array) -> Array:
    """`cluster_interval` of many campaigns at once: (campaigns, episodes) counts to (campaigns, 2) bounds."""
    s, m = np.asarray(successes), np.asarray(attempts)
    plain = np.array([wilson(a, n) for a, n in zip(s.sum(1), m.sum(1), strict=True)])
    bounds = _posterior_bounds(s, m)
    return np.column_stack([np.minimum(plain[:, 0], bounds[:, 0]), np.maximum(plain[:, 1], bounds[:, 1])])


def _posterior_bounds(s: Array, m: Array) -> Array:
    """2.5 % and 97.5 % quantiles of the mean rate, (campaigns, 2)."""
    edges = _rate_edges(s, m)
    rate = (edges[1:] + edges[:-1]) / 2
    concentration = (1 - _ICC) / _ICC
    # Jeffreys' prior and the nodes' width: d rate / sqrt(rate (1 - rate)) = sqrt(rate (1 - rate)) d logit(rate)
    prior = np.diff(2 * np.arcsin(np.sqrt(edges)))
    a, b = rate[:, None] * concentration, (1 - rate)[:, None] * concentration
    kinds, which = np.unique(np.stack([s, m], -1).reshape(-1, 2), axis=0, return_inverse=True)
    table = np.stack([betaln(a + k, b + (n - k)) - betaln(a, b) for k, n in kinds]).reshape(len(kinds), -1)
    counts = np.zeros((len(s), len(kinds)))
    np.add.at(counts, (np.arange(len(s))[:, None], which.reshape(s.shape)), 1.0)
    log = counts @ table
    density = np.exp(log - log.max(1, keepdims=True)).reshape(len(s), len(rate), -1).sum(2) * prior
    cumulated = np.cumsum(density, 1)
    cumulated = np.column_stack([np.zeros(len(s)), cumulated / cumulated[:, -1:]])
    return np.array([np.interp((LOWER, UPPER), c, edges) for c in cumulated])


def _rate_edges(s: Array, m: Array) -> Array:
    """Edges of the cells of the rate, even in the logit, over all that any of the campaigns leaves possible."""
    n = m.sum(1)
    effect = 1 + ((m**2).sum(1) / n - 1) * _ICC[-1]
    wide = [wilson(a / e, b / e, _WIDE) for a, b, e in zip(s.sum(1), n, effect, strict=True)]
    low, high = (min(w[0] for w in wide), max(w[1] for w in wide))
    first, last = logit([max(low, 1e-9), min(high, 1 - 1e-9)])
    return np.asarray(expit(np.linspace(first, last, _RATES + 1)))


def pair_interval(better: int, worse: int, n: int) -> tuple[float, float]:
    """95 % score interval of the difference of two paired rates (Tango 1998): of second minus first.

    Args:
        better: pairs that only the second got right; worse: pairs that only the first got right.
        n: all pairs.
    """
    if n <= 0:
        return (-1.0, 1.0)
    seen = (better - worse) / n

    def excess(d: float) -> float:
        """Score statistic's square over z^2, less 1, at a difference d."""
        # restricted maximum-likelihood estimate of the chance that only the first is right
        b = -better - worse + (2 * n - better + worse) * d
        q = (sqrt(max(b * b + 8 * n * worse * d * (1 - d), 0.0)) - b) / (4 * n)
        variance = n * (2 * q + d * (1 - d))
        return (better - worse - n * d) ** 2 / max(variance, 1e-300) - Z95**2

    low = -1.0 if excess(-1 + 1e-12) < 0 else brentq(excess, -1 + 1e-12, seen)
    high = 1.0 if excess(1 - 1e-12) < 0 else brentq(excess, seen, 1 - 1e-12)
    return (float(low), float(high))


def difference_interval(first: Counts, second: Counts) -> tuple[float, float]:
    """95 % interval of the difference of two pooled rates of the same episodes, second minus first.

    Linearised variance of the paired difference of two ratios (Kish 1965, section 6.4) with Student's quantile at
    (episodes - 1) degrees of freedom, and to the variance `UNSEEN_FAILURES` more, so that two campaigns without a
    difference do not come out as equal for certain. With fewer than two episodes (-1, 1).

    Args:
        first, second: successes and attempts of each episode, in the same order of episodes.
    """
    bounds = difference_intervals(*((np.asarray(s)[None], np.asarray(m)[None]) for s, m in (first, second)))
    return (float(bounds[0, 0]), float(bounds[0, 1]))


def difference_intervals(first: tuple[Array, Array], second: tuple[Array, Array]) -> Array:
    """`difference_interval` of many campaigns at once: (campaigns, episodes) counts to (campaigns, 2) bounds."""
    n1, n2 = first[1].sum(1), second[1].sum(1)
    episodes = first[0].shape[1]
    if episodes < 2 or not (np.all(n1) and np.all(n2)):
        return np.tile((-1.0, 1.0), (len(n1), 1))
    difference = second[0].sum(1) / n2 - first[0].sum(1) / n1
    variance = difference_variances(first, second)
    half = stdtrit(episodes - 1, UPPER) * np.sqrt(variance)
    return np.clip(np.column_stack([difference - half, difference + half]), -1.0, 1.0)


def difference_variances(first: tuple[Array, Array], second: tuple[Array, Array]) -> Array:
    """Variance of the paired difference of two pooled rates, as `difference_interval` takes it; (campaigns,)."""
    m1, m2 = first[1], second[1]
    n1, n2 = m1.sum(1), m2.sum(1)
    size = ((m1**2).sum(1) + (m2**2).sum(1)) / (n1 + n2)  # mean episode size, weighted by attempts
    unseen = UNSEEN_FAILURES * (1 + (size - 1) * UNSEEN_ICC) / (n1 * n2)
    return _linearised_variances(first, second) + unseen


def ratio_difference_interval(
    first: tuple[Sequence[float], Sequence[float]], second: tuple[Sequence[float], Sequence[float]]
) -> tuple[float, float]:
    """95 % interval of the difference of two ratios of sums over the same episodes, second minus first.

    For measured quantities, such as seconds an attempt: the variance is `difference_interval`'s, without what stands
    there for failures that were not seen.

    Args:
        first, second: numerators and denominators of each of two or more episodes, in the same order.
    """
    sides = tuple(tuple(np.asarray(part, dtype=float)[None] for part in side) for side in (first, second))
    (a, m), (b, n) = sides
    difference = float(b.sum() / n.sum() - a.sum() / m.sum())
    half = float(stdtrit(a.shape[1] - 1, UPPER) * np.sqrt(_linearised_variances((a, m), (b, n))[0]))
    return (difference - half, difference + half)


def _linearised_variances(first: tuple[Array, Array], second: tuple[Array, Array]) -> Array:
    """Variance of the paired difference of two ratios of sums (Kish 1965, section 6.4); (campaigns,)."""
    (s1, m1), (s2, m2) = first, second
    n1, n2, episodes = m1.sum(1), m2.sum(1), s1.shape[1]
    residual = (s2 - (s2.sum(1) / n2)[:, None] * m2) / n2[:, None] - (s1 - (s1.sum(1) / n1)[:, None] * m1) / n1[:, None]
    return np.asarray(episodes / (episodes - 1) * (residual**2).sum(1))
