"""Calibrates the score of a workpiece's poses on validation heaps."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from rich.console import Console

from pickproof.cell.frames import Array
from pickproof.cell.sensing.sensor_model import SensorConfig
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.data.scenes import VALIDATION_SEED
from pickproof.perception.evaluation.analysis import right_poses
from pickproof.perception.evaluation.heap_frames import HeapFrame, Setup, perceive_seeds
from pickproof.perception.evaluation.metrics import POINTS
from pickproof.perception.refinement.score_model import FEATURES, ScoreModel, brier_score, reliability

LEAST = 25
"""Right and wrong poses that each half must hold; signs and ridge keep weights that so few cannot support near 0."""
LEAST_STANDING = 3
"""Of them, right and wrong ones among the standing poses of each half, which two parameters are fitted to."""


@dataclass(frozen=True)
class Examples:
    """Examined poses.

    Attributes:
        features: (n, len(FEATURES)).
        right: (n,) bool.
        standing: (n,) bool, those without a better rival (`Examined.standing`).
        frame: (n,) index of the frame each is of.
    """

    features: Array
    right: np.ndarray
    standing: np.ndarray
    frame: np.ndarray

    def select(self, mask: np.ndarray) -> Examples:
        """Those in the mask (n,)."""
        return Examples(self.features[mask], self.right[mask], self.standing[mask], self.frame[mask])


@dataclass(frozen=True)
class Fit:
    """What a fit came to.

    Attributes:
        model: to be used; None where the default is kept.
        record: counts, and the figures of default and fit on the half of the frames that was not fitted.
        reason: why the default is kept; empty with a model.
    """

    model: ScoreModel | None
    record: dict[str, object]
    reason: str = ""


def examples_of(frames: Iterable[HeapFrame], workpiece: Workpiece) -> Examples:
    """Every pose that verification examined in these frames, labelled by the truth."""
    points = workpiece.sample_surface(POINTS)[0]
    none = np.zeros(0, dtype=bool)
    parts = [Examples(np.zeros((0, len(FEATURES))), none, none, np.zeros(0, dtype=np.int64))]
    for i, seen in enumerate(frames):
        if (examined := seen.result.examined) is not None:
            poses = examined.Ts_camera_part
            right = right_poses(poses, seen.Ts_camera_part, points, workpiece)
            standing = np.isin(np.arange(len(poses)), examined.standing)
            parts.append(Examples(examined.features, right, standing, np.full(len(poses), i)))
    return Examples(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Examples)))


def fit(examples: Examples) -> Fit:
    """Fit on every other frame, compare with the default on the standing poses of the rest; if better, fit on all."""
    halves = [examples.select(examples.frame % 2 == k) for k in (0, 1)]
    record: dict[str, object] = {
        "right": int(examples.right.sum()),
        "wrong": int((~examples.right).sum()),
        "standing_right": int((examples.right & examples.standing).sum()),
        "standing_wrong": int((~examples.right & examples.standing).sum()),
    }
    for least, name, kept in (
        (LEAST, "examined", [half.right for half in halves]),
        (LEAST_STANDING, "unrivalled", [half.right[half.standing] for half in halves]),
    ):
        for kind, fewest in (("right", min(r.sum() for r in kept)), ("wrong", min((~r).sum() for r in kept))):
            if fewest < least:
                reason = f"too few {kind} {name} poses: {fewest} in a half of the frames, {least} are needed"
                return Fit(None, record, reason)
    model, other = fit_model(halves[0]), halves[1].select(halves[1].standing)
    before, after = ScoreModel().score(other.features), model.score(other.features)
    record["unfitted_half"] = {
        "standing": len(other.right),
        "right": int(other.right.sum()),
        "ece_before": reliability(before, other.right)["ece"],
        "ece_after": reliability(after, other.right)["ece"],
        "brier_before": brier_score(before, other.right),
        "brier_after": brier_score(after, other.right),
    }
    if brier_score(after, other.right) >= brier_score(before, other.right):
        return Fit(None, record, "on the frames not fitted, the fit is no better than the default")
    return Fit(fit_model(examples), record)


def fit_model(examples: Examples) -> ScoreModel:
    """Weights from all poses, as the score orders rivals; then the odds of the standing ones, which are right more
    often than examined poses that look alike."""
    standing = examples.select(examples.standing)
    return ScoreModel.fit(examples.features, examples.right).rescaled(standing.features, standing.right)


def fit_score(workpiece: Workpiece, frames: int, weights: Path | None, workers: int, console: Console) -> Fit:
    """Fit the score of a workpiece's poses on that many validation heaps; `console` shows the progress.

    Raises:
        InputError: the weights cannot be read.
    """
    setup = Setup(workpiece.name, weights, SensorConfig(), VALIDATION_SEED, calibrated=False)
    setup.check()
    with perceive_seeds(setup, VALIDATION_SEED, frames, workers, console, "examining") as seen:
        return fit(examples_of(seen, workpiece))
