"""The two decisions about poses: the order in which rivals are settled, and which of the rest are accepted.

Votes that the search makes are made from its poses, and confirm whatever made them. So the order does not look at
votes; the acceptance does, at those that the standing poses leave to each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from pickproof.cell.frames import Array
from pickproof.perception.refinement.evidence import Evidence
from pickproof.perception.refinement.score_model import FEATURES as VERIFIED

FEATURES = (*VERIFIED, "outside")
"""Those of the score model, and the share of the CAD outside the bin."""


@dataclass(frozen=True)
class DecisionModel:
    """Log odds that a pose is right: bias + features @ weights.

    Attributes:
        weights: one a feature, in the order of FEATURES.
        bias: the constant.
    """

    weights: tuple[float, ...]
    bias: float

    @staticmethod
    def of(bias: float, weights: Mapping[str, float]) -> DecisionModel:
        """From the weights that are not zero, by name."""
        return DecisionModel(tuple(weights.get(name, 0.0) for name in FEATURES), bias)

    def log_odds(self, features: Array) -> Array:
        """(h,) of features (h, len(FEATURES))."""
        # a plain sum: products of matrices add in an order that depends on the processor
        return np.asarray((features * np.asarray(self.weights)).sum(1) + self.bias)

    def score(self, features: Array) -> Array:
        """Probabilities (h,) in [0, 1]."""
        return np.asarray(expit(self.log_odds(features)))


@dataclass(frozen=True)
class Decisions:
    """The model of the order and that of the acceptance; a pose is accepted from the score `threshold` on."""

    order: DecisionModel
    acceptance: DecisionModel
    threshold: float = 0.5


_ORDER = DecisionModel.of(
    1.88,
    {
        "violations": -17.157,
        "wrong_normal": -1.355,
        "log_area": 0.831,
        "occluded": -0.673,
        "beside": -7.429,
        "outside": -25.914,
    },
)
ALONE = Decisions(
    _ORDER,
    DecisionModel.of(
        2.88,
        {
            "violations": -23.5,
            "log_area": 1.08,
            "beside": -9.14,
            "residual": -8.06,
            "facing": -3.53,
            "rotations_agree": 3.79,
            "outside": -32.52,
        },
    ),
)
"""The order fitted to fifteen parts, the acceptance to seventeen, docs/measurements/search.md; votes are its own."""
WITH_NETWORK = Decisions(
    _ORDER,
    DecisionModel.of(
        7.732,
        {
            "violations": -21.006,
            "wrong_normal": -34.528,
            "log_inliers": 0.733,
            "log_area": 0.182,
            "beside": -149.791,
            "facing": -18.348,
            "centres_agree": 1.603,
            "outside": -15.264,
        },
    ),
)
"""The acceptance where a network votes: its votes are evidence that the search has not made itself."""


def features_of(evidence: Evidence, outside: Array, tolerance: float) -> Array:
    """Inputs (h, len(FEATURES)) of the models; `outside` (h,) as in `outside.outside`."""
    return np.concatenate([evidence.features(tolerance), outside[:, None]], axis=1)


def with_votes(features: Array, evidence: Evidence) -> Array:
    """The features (h, len(FEATURES)) with those of votes as in `evidence`."""
    features = features.copy()
    features[:, FEATURES.index("log_votes")] = np.log1p(evidence.votes)
    features[:, FEATURES.index("centres_agree")] = evidence.centres_agree
    features[:, FEATURES.index("rotations_agree")] = evidence.rotations_agree
    return features
