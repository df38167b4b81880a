"""Where workpieces may be: the positions that hypotheses are made for.

Takes votes and their clusters; gives `Places`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import Categories, Modes, evenly, least_votes, mean_shift, square_distances
from pickproof.perception.refinement.config import HypothesisConfig


@dataclass(frozen=True)
class Places:
    """Where workpieces may be: the categories of the clustering, then peaks of the predicted centres alone.

    A weak network finds the centre long before the rotation; its instances have too scattered rotations to make a
    mode, and only their position betrays them.

    Attributes:
        positions: (n, 3) in units; counts: (n,) votes near each; of_vote: (m,) and of_mode: (k,) nearest place of each
            vote and mode, -1 for none.
    """

    positions: np.ndarray
    counts: np.ndarray
    of_vote: np.ndarray
    of_mode: np.ndarray


def find_places(
    votes: Votes, modes: Modes, categories: Categories, shape: ShapeModel, config: HypothesisConfig
) -> Places:
    """Categories, and peaks of position that are no category."""
    reach = config.place_bandwidth
    centres = shape.fold(votes.centres, votes.rotations, votes.middle)
    positions = categories.positions
    folded = shape.fold(positions, categories.rotations, votes.middle)
    peaks = mean_shift(evenly(centres, 1500) / reach, 512, 15) * reach
    if len(peaks):
        near = _distances(centres, peaks) < reach
        count = near.sum(0)
        new = count >= least_votes(config.min_votes_place, len(votes))
        if len(positions):
            new &= _distances(folded, peaks).min(0) > 0.8 * reach
        best_first = np.flatnonzero(new)[np.argsort(-count[new], kind="stable")]
        added = best_first[: max(0, config.max_places - len(positions))]
        means = [votes.centres[near[:, i]].mean(0) for i in added] if shape.slender else peaks[added]
        positions = np.concatenate([positions, np.reshape(means, (-1, 3))])
        folded = np.concatenate([folded, peaks[added]])
    if len(positions) == 0:
        none = np.zeros(0, dtype=np.int64)
        return Places(positions, none, np.full(len(votes), -1), np.full(len(modes.counts), -1))
    gaps = _distances(centres, folded)
    of_vote = np.where(gaps.min(1) < 1.25 * reach, gaps.argmin(1), -1)
    of_mode = np.zeros(0, dtype=np.int64)
    if len(modes.counts):
        gaps = _distances(shape.fold(modes.positions, modes.rotations, votes.middle), folded)
        of_mode = np.where(gaps.min(1) < 1.25 * reach, gaps.argmin(1), -1)
    return Places(positions, np.bincount(of_vote[of_vote >= 0], minlength=len(positions)), of_vote, of_mode)


def _distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(square_distances(a, b)))
