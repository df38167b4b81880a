"""The test of the gate: paired differences, looked at after every episode, stopped as soon as it is decided.

Two bets run side by side (Waudby-Smith and Ramdas 2024, section 4; Robbins' mixtures). One player stakes a share of
his capital on "the candidate is worse" in every episode, at odds that are fair if it is not; the other stakes on "it
is not worse by the margin". By Ville's inequality a fair game multiplies the stake by 1 / a with a chance of at most
a, whenever one stops and looks, so capital is evidence that needs no plan of how many episodes to run. The picks of
one bin may be correlated in any way: an episode is one bet. On first attempts, where a difference is -1, 0 or 1, the
first bet is the mixture likelihood ratio of McNemar's discordant pairs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import brentq
from scipy.special import logsumexp
from scipy.stats import beta

from pickproof.cell.frames import Array

Decision = Literal["passed", "worse", "undecided"]
DECISIONS: tuple[Decision, ...] = ("undecided", "worse", "passed")

_SHARES = (np.arange(24) + 0.5) / 24
_WEIGHTS = beta.pdf(_SHARES, 2.5, 1.25) / beta.pdf(_SHARES, 2.5, 1.25).sum()  # chosen by simulation


@dataclass(frozen=True)
class Rule:
    """What the gate holds to.

    Attributes:
        margin: loss of rate that must not pass, in (0, 1).
        alpha: greatest chance of "worse" if the candidate is not worse.
        power: 1 less the greatest chance of "passed" if it is worse by the margin or more.
    """

    margin: float = 0.02
    alpha: float = 0.05
    power: float = 0.9

    def __post_init__(self) -> None:
        if not (0 < self.margin < 1 and 0 < self.alpha < 1 and 0 < self.power < 1):
            raise ValueError(f"{self}: margin, alpha and power lie between 0 and 1")


def evidence(differences: Array, mean: float) -> Array:
    """Logarithm of the capital won against "the mean difference is `mean` or less", after every episode.

    Args:
        differences: (..., episodes), each in [-1, 1], of independent episodes.
        mean: in (-1, 1].
    """
    shares = _SHARES / (1 + mean)  # no bet loses more than there is, even at a difference of -1
    steps = np.log1p(shares * (np.asarray(differences, dtype=float)[..., None] - mean))
    return np.asarray(logsumexp(np.log(_WEIGHTS) + np.cumsum(steps, axis=-2), axis=-1))


def decide(differences: Array, rule: Rule) -> tuple[Array, Array]:
    """Decisions of many gates and the episodes that they took.

    Args:
        differences: (gates, episodes) of candidate minus baseline.

    Returns:
        (gates,) index into DECISIONS, and (gates,) episodes up to the decision, all of them where there is none.
    """
    if not differences.shape[-1]:
        return np.zeros(len(differences), dtype=int), np.zeros(len(differences), dtype=int)
    worse = evidence(-differences, 0.0) >= np.log(1 / rule.alpha)
    passed = evidence(differences, -rule.margin) >= np.log(1 / (1 - rule.power))
    ended = worse | passed
    first = np.where(ended.any(-1), ended.argmax(-1), differences.shape[-1] - 1)
    at = (np.arange(len(differences)), first)
    return np.where(worse[at], 1, np.where(passed[at], 2, 0)), first + 1


def bounds(differences: Array, alpha: float) -> tuple[float, float]:
    """Bounds of the mean difference that hold together, at every look, with a chance of at least 1 - alpha."""
    edge = 1e-6

    def lower(x: Array) -> float:
        def excess(mean: float) -> float:
            return float(evidence(x, mean)[-1]) - float(np.log(2 / alpha))

        return -1.0 if excess(-1 + edge) < 0 else float(brentq(excess, -1 + edge, 1.0, xtol=1e-5))

    if len(differences) == 0:
        return (-1.0, 1.0)
    return lower(differences), -lower(-differences)
