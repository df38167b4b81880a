"""A set of poses to be tried, and how it is thinned: the best of each place, and none twice.

Takes and gives `Hypotheses`; thinning gives indices into it. How near two poses are is their distance in position and
embedded rotation (`ShapeModel.embed`), in units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.ps6d.voting import square_distances


@dataclass(frozen=True)
class Hypotheses:
    """Poses to be tried: rotations (h, 3, 3), positions (h, 3) in units, the place (h,) and score (h,) of each."""

    rotations: torch.Tensor
    positions: torch.Tensor
    places: np.ndarray
    scores: np.ndarray

    def __len__(self) -> int:
        return len(self.places)

    def select(self, index: np.ndarray) -> Hypotheses:
        """The hypotheses at `index`."""
        i = torch.from_numpy(index)
        return Hypotheses(self.rotations[i], self.positions[i], self.places[index], self.scores[index])


def top_scores(places: np.ndarray, scores: np.ndarray, keep: int) -> np.ndarray:
    """Indices of the `keep` best scores of each place."""
    order = np.lexsort((-scores, places))
    first = np.searchsorted(places[order], places[order], side="left")
    return np.asarray(order[np.arange(len(order)) - first < keep])


def best_of_each_place(hypotheses: Hypotheses, shape: ShapeModel, keep: int, apart: float) -> np.ndarray:
    """Indices of the `keep` best hypotheses of each place that are at least `apart` from a better one there."""
    embedded = np.concatenate(
        [hypotheses.positions.numpy(), shape.embed(hypotheses.rotations.numpy().astype(np.float64))], axis=1
    )
    order = np.lexsort((-hypotheses.scores, hypotheses.places))
    bounds = np.flatnonzero(np.diff(hypotheses.places[order])) + 1
    kept = []
    for members in np.split(order, bounds):
        best = members[: 16 * keep]
        kept.append(best[_first_distinct(embedded[best], apart, keep)])
    return np.concatenate(kept) if kept else np.zeros(0, dtype=np.int64)


def distinct(R: torch.Tensor, t: torch.Tensor, scores: np.ndarray, shape: ShapeModel, apart: float) -> np.ndarray:
    """Indices, best score first, of poses that no better one is nearer to than `apart`, whatever their place."""
    embedded = np.concatenate([t.numpy(), shape.embed(R.numpy().astype(np.float64))], axis=1)
    order = np.argsort(-scores, kind="stable")
    return np.asarray(order[_first_distinct(embedded[order], apart)], dtype=np.int64)


def _first_distinct(x: np.ndarray, apart: float, most: int | None = None) -> list[int]:
    """Indices of the first rows of x (n, d), `most` at most, that are at least `apart` from every earlier one."""
    like = square_distances(x, x) < apart**2
    free = np.ones(len(x), dtype=bool)
    kept: list[int] = []
    while free.any() and len(kept) != most:
        kept.append(int(free.argmax()))
        free &= ~like[kept[-1]]
        free[kept[-1]] = False
    return kept
