"""From the evidence of verification to a calibrated score: logistic regression over a few features."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from pickproof.cell.errors import InputError
from pickproof.cell.workpiece.workpiece import Workpiece

Floats = NDArray[np.float64]

FEATURES = (
    "violations",
    "wrong_normal",
    "log_inliers",
    "log_area",
    "occluded",
    "beside",
    "residual",
    "facing",
    "log_votes",
    "centres_agree",
    "rotations_agree",
)
SIGNS = (-1, -1, 1, 1, -1, -1, -1, -1, 1, 1, 1)
"""Whether a feature speaks for a pose or against it."""

SCHEMA = 1
FITTED_THRESHOLD = 0.5


@dataclass(frozen=True)
class ScoreModel:
    """Probability that a pose is right: expit(bias + features @ weights).

    Attributes:
        weights: one a feature, in the order of FEATURES.
        bias: the constant.
        threshold: least score of an accepted pose: 0.5 where the scores were fitted to the workpiece, higher where they
            were not.
    """

    weights: tuple[float, ...] = (-19.64, -4.261, 1.324, 0.3903, -3.164, -129, -11.99, 0, 0.6269, 1.782, 2.562)
    bias: float = 4.173
    threshold: float = 0.8

    def score(self, features: Floats) -> Floats:
        """Scores (h,) in [0, 1] of features (h, len(FEATURES))."""
        return np.asarray(expit(features @ np.asarray(self.weights) + self.bias))

    @staticmethod
    def fit(features: Floats, right: np.ndarray, ridge: float = 1.0) -> ScoreModel:
        """Fit to features (n, len(FEATURES)) and labels (n,): penalised likelihood under the signs of SIGNS.

        Without the signs, a feature that hardly varies among plausible poses can get a weight that favours absurd ones.
        """
        mean, spread = features.mean(0), np.maximum(features.std(0), 1e-6)
        X = np.column_stack([(features - mean) / spread, np.ones(len(features))])
        y = right.astype(np.float64)
        penalty = np.append(np.full(len(FEATURES), ridge), 1e-6)

        def loss(w: Floats) -> tuple[float, Floats]:
            z = X @ w
            value = np.logaddexp(0.0, z).sum() - y @ z + 0.5 * penalty @ w**2
            return float(value), X.T @ (expit(z) - y) + penalty * w

        bounds = [(0.0, None) if sign > 0 else (None, 0.0) for sign in SIGNS] + [(None, None)]
        w = minimize(loss, np.zeros(X.shape[1]), jac=True, method="L-BFGS-B", bounds=bounds).x
        weights = w[:-1] / spread
        return ScoreModel(tuple(float(x) for x in weights), float(w[-1] - mean @ weights), FITTED_THRESHOLD)

    def rescaled(self, features: Floats, right: np.ndarray) -> ScoreModel:
        """The same order of poses with the odds of others, (n, len(FEATURES)) and (n,) bool (Platt 1999)."""
        z = features @ np.asarray(self.weights) + self.bias
        n = int(right.sum())
        y = np.where(right, (n + 1) / (n + 2), 1 / (len(right) - n + 2))

        def loss(w: Floats) -> float:
            s = w[0] * z + w[1]
            return float(np.logaddexp(0.0, s).sum() - y @ s)

        slope, shift = minimize(loss, np.array([1.0, 0.0]), method="L-BFGS-B", bounds=[(1e-3, None), (None, None)]).x
        weights = tuple(float(slope * w) for w in self.weights)
        return ScoreModel(weights, float(slope * self.bias + shift), FITTED_THRESHOLD)

    def save(self, path: Path, record: dict[str, object] | None = None) -> None:
        """Write as JSON; `record` says how the model was made."""
        data = {"schema": SCHEMA, "weights": dict(zip(FEATURES, self.weights, strict=True)), "bias": self.bias}
        data["threshold"] = self.threshold
        part = path.with_suffix(".part")
        part.write_text(json.dumps(data | {"record": record or {}}, indent=1) + "\n", encoding="utf-8")
        part.replace(path)

    @staticmethod
    def load(path: Path) -> ScoreModel:
        """Read what `save` wrote.

        Raises:
            InputError: the file is missing or not what `save` writes.
        """
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            weights = tuple(float(data["weights"][name]) for name in FEATURES)
            bias = float(data["bias"])
            threshold = float(data.get("threshold", FITTED_THRESHOLD))
        except (OSError, ValueError, KeyError, TypeError) as error:
            valid = f"numbers for bias and {', '.join(FEATURES)}, as `pickproof fit-score` writes them"
            raise InputError(path, "weights", repr(error), valid) from None
        if data.get("schema") != SCHEMA:
            raise InputError(path, "schema", data.get("schema"), str(SCHEMA))
        return ScoreModel(weights, bias, threshold)


def score_path(workpiece: Workpiece) -> Path:
    """Where a workpiece's own score model lies."""
    return workpiece.folder / "score.json"


def reliability(scores: Floats, right: np.ndarray, bins: int = 10) -> dict[str, object]:
    """Reliability curve and expected calibration error (Guo et al. 2017) of scores (n,) against outcomes (n,) bool."""
    scores = np.asarray(scores, dtype=np.float64)
    which = np.minimum((scores * bins).astype(int), bins - 1)
    rows, ece = [], 0.0
    for b in range(bins):
        mine = which == b
        if mine.any():
            mean, share = float(np.mean(scores[mine])), float(np.mean(right[mine]))
            ece += float(mine.mean()) * abs(mean - share)
            rows.append({"count": int(mine.sum()), "mean_score": mean, "share_right": share})
    return {"ece": ece, "bins": rows}


def brier_score(scores: Floats, right: np.ndarray) -> float:
    """Mean squared difference of scores (n,) and outcomes (n,) bool (Brier 1950): smaller is better, and the least in
    expectation for the true probabilities."""
    return float(np.mean((scores - right) ** 2))
