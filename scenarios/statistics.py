"""Intervals for a pick success rate.

Picks of one bin are not independent: a heap that is hard to pick is hard more than once. `wilson` ignores that,
`cluster_interval` does not. Both stay inside [0, 1] and neither has width 0, whatever the counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np
from scipy.stats import norm, t

Z95 = float(norm.ppf(0.975))
ASSUMED_ICC = 0.05
"""Correlation within a bin that is assumed where the data cannot show it."""
FEW_EPISODES = 5


def wilson(successes: float, n: float, z: float = Z95) -> tuple[float, float]:
    """Score interval of a binomial rate (Wilson 1927, eq. as in Brown, Cai, DasGupta 2001); (0, 1) for n = 0."""
    if n <= 0:
        return (0.0, 1.0)
    p = successes / n
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return (0.0 if successes == 0 else centre - half, 1.0 if successes == n else centre + half)


def design_effect(successes: Sequence[int], attempts: Sequence[int]) -> float:
    """Variance of the rate with episodes as clusters over its binomial variance.

    The ratio estimator's linearised variance (Kish 1965, section 6.3); 1.0 where the rate is 0 or 1.
    """
    s, m = np.asarray(successes, dtype=float), np.asarray(attempts, dtype=float)
    k, n = len(m), float(m.sum())
    p = float(s.sum()) / n
    if k < 2 or p in (0.0, 1.0):
        return 1.0
    variance = k / (k - 1) * float(((s - p * m) ** 2).sum()) / n**2
    return variance / (p * (1 - p) / n)


def cluster_interval(successes: Sequence[int], attempts: Sequence[int]) -> tuple[float, float]:
    """95 % interval of the pooled rate that respects clustering by episode.

    Wilson's interval at the effective sample size n / D, where D is the measured design effect, at least 1, with
    Student's quantile at (episodes - 1) degrees of freedom. With fewer than five episodes, or with failures (or
    successes) in fewer than two of them, the data cannot show D: it is then at least 1 + (m - 1) ICC for the mean
    episode size m and an assumed ICC of 0.05, with the normal quantile. In simulation this covers 90 to 99 % where a
    cluster bootstrap, percentile or BCa, covers 70 to 92 % (docs/scenarios.md).

    Args:
        successes, attempts: of each episode.
    """
    pairs = [(s, m) for s, m in zip(successes, attempts, strict=True) if m > 0]
    if not pairs:
        return (0.0, 1.0)
    s, m = (list(column) for column in zip(*pairs, strict=True))
    n, k = sum(m), len(m)
    effect, z = max(design_effect(s, m), 1.0), Z95
    hidden = sum(a < b for a, b in pairs) < 2 or sum(a > 0 for a, _ in pairs) < 2
    if k < FEW_EPISODES or hidden:
        size = sum(b * b for b in m) / n  # mean episode size, weighted by attempts
        effect = max(effect, 1 + (size - 1) * ASSUMED_ICC)
    else:
        z = float(t.ppf(0.975, k - 1))
    return wilson(sum(s) / effect, n / effect, z)
