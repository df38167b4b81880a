"""From clusters to pose hypotheses, and from thousands of them to the few per place that deserve ICP.

Takes votes, their clusters and places, and the measured surface; gives `Hypotheses`, the best few of each place.
Places come from `places.py`, poses fitted to CAD coordinates from `pose_fit.py`, thinning from `hypothesis_set.py`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch

from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import Categories, Modes, evenly
from pickproof.perception.refinement.config import HypothesisConfig
from pickproof.perception.refinement.depth_agreement import soft_score
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.hypothesis_set import Hypotheses, best_of_each_place, distinct, top_scores
from pickproof.perception.refinement.places import Places, find_places
from pickproof.perception.refinement.pose_fit import GATHER_ROUNDS, gather, kabsch

FEWEST_VOTES = 4
"""Votes that a pose is fitted to, at least."""


def propose(
    votes: Votes,
    modes: Modes,
    categories: Categories,
    places: Places,
    scene: SurfaceMap,
    shape: ShapeModel,
    config: HypothesisConfig,
) -> Hypotheses:
    """All hypotheses of all places, scored against the depth image; the best few of each place."""
    guesses = _from_clusters(votes, modes, categories, places, config)
    if votes.cad_coordinates is not None and shape.symmetry.infinite_axis is None:
        guesses = _fitted_to_votes(guesses, votes, shape, config)
    if config.near_symmetries:
        guesses = _with_near_symmetries(guesses, shape)
    if shape.slender and config.slide_reach > 0:
        guesses = _slid_along_axis(guesses, shape, config)
    return _best(guesses, scene, shape, config)


class Guesses(NamedTuple):
    """Poses without a score: rotations (h, 3, 3), positions (h, 3) in units, and the place (h,) of each."""

    R: np.ndarray
    t: np.ndarray
    place: np.ndarray


def _from_clusters(
    votes: Votes, modes: Modes, categories: Categories, places: Places, config: HypothesisConfig
) -> Guesses:
    """Voted poses, averages of modes, single votes at each place, and poses fitted to modes and to places."""
    in_place = np.flatnonzero(places.of_mode >= 0)
    voted = Guesses(categories.rotations, categories.positions, np.arange(len(categories.counts)))
    averages = Guesses(modes.rotations[in_place], modes.positions[in_place], places.of_mode[in_place])
    parts = [voted, averages]
    if config.votes_per_place:
        parts += _single_votes(votes, places, config.votes_per_place)
    if votes.cad_coordinates is not None:
        of_modes = np.append(places.of_mode, -1)[modes.labels]
        mode_of_vote = np.where(of_modes >= 0, modes.labels, -1)
        parts.append(_fitted_to_groups(votes, mode_of_vote, places.of_mode))
        parts.append(_fitted_to_groups(votes, places.of_vote, np.arange(len(places.positions))))
    return _joined(parts)


def _single_votes(votes: Votes, places: Places, count: int) -> list[Guesses]:
    """`count` predicted rotations, evenly spaced, at the position of each place."""
    found = []
    for c, position in enumerate(places.positions):
        members = np.flatnonzero(places.of_vote == c)
        if len(members):
            few = members[np.unique(np.linspace(0, len(members) - 1, count).round().astype(int))]
            found.append(Guesses(votes.rotations[few], np.broadcast_to(position, (len(few), 3)), np.full(len(few), c)))
    return found


def _fitted_to_groups(votes: Votes, labels: np.ndarray, place_of: np.ndarray) -> Guesses:
    """One pose fitted to the CAD coordinates of each group of votes; `labels` (m,), -1 for none, index `place_of`."""
    assert votes.cad_coordinates is not None
    enough = np.flatnonzero(np.bincount(labels[labels >= 0], minlength=len(place_of)) >= FEWEST_VOTES)
    renumber = np.full(len(place_of) + 1, -1)
    renumber[enough] = np.arange(len(enough))
    groups = renumber[labels]
    mine = groups >= 0
    R, t = kabsch(votes.cad_coordinates[mine], votes.points[mine], groups[mine], len(enough))
    return Guesses(R, t, place_of[enough])


def _fitted_to_votes(guesses: Guesses, votes: Votes, shape: ShapeModel, config: HypothesisConfig) -> Guesses:
    """Guesses fitted to the votes that agree with them; those of compact parts are added to what they came from."""
    if shape.slender:
        return Guesses(*gather(guesses.R, guesses.t, votes, shape, GATHER_ROUNDS), guesses.place)
    few = votes.select(evenly(np.arange(len(votes)), config.gather_votes))
    fitted = Guesses(*gather(guesses.R, guesses.t, few, shape, GATHER_ROUNDS[1:]), guesses.place)
    both = _joined([fitted, guesses])
    unscored = Hypotheses(
        torch.from_numpy(both.R), torch.from_numpy(both.t), both.place, scores=np.zeros(len(both.place))
    )
    kept = best_of_each_place(unscored, shape, len(both.place), config.alike)
    return Guesses(both.R[kept], both.t[kept], both.place[kept])


def _with_near_symmetries(guesses: Guesses, shape: ShapeModel) -> Guesses:
    """Each guess turned by every near symmetry of the CAD; the first of these leaves it as it is."""
    near = shape.near_symmetries
    R = np.einsum("hij,sjk->hsik", guesses.R, near).reshape(-1, 3, 3)
    return Guesses(R, np.repeat(guesses.t, len(near), axis=0), np.repeat(guesses.place, len(near)))


def _slid_along_axis(guesses: Guesses, shape: ShapeModel, config: HypothesisConfig) -> Guesses:
    """Guesses shifted in steps along the axis of a slender part."""
    n = round(config.slide_reach / config.slide_step)
    steps = config.slide_step * np.arange(-n, n + 1)
    t = guesses.t[:, None] + steps[None, :, None] * (guesses.R @ shape.long_axis)[:, None]
    return Guesses(np.repeat(guesses.R, len(steps), axis=0), t.reshape(-1, 3), np.repeat(guesses.place, len(steps)))


def _best(guesses: Guesses, scene: SurfaceMap, shape: ShapeModel, config: HypothesisConfig) -> Hypotheses:
    """The best of each place that differ, by a rough score of all and a finer one of the first few."""
    tolerance = config.tolerance * shape.fineness
    R, t = (torch.from_numpy(x.astype(np.float32)) for x in (guesses.R, guesses.t))
    scores = soft_score(R, t, scene, shape, config.screen_points, tolerance).numpy()
    few = Hypotheses(R, t, guesses.place, scores).select(top_scores(guesses.place, scores, 4 * config.keep))
    scored = replace(
        few, scores=soft_score(few.rotations, few.positions, scene, shape, config.points, tolerance).numpy()
    )
    return scored.select(best_of_each_place(scored, shape, config.keep, config.apart))


def _joined(parts: list[Guesses]) -> Guesses:
    R, t, place = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Guesses(R, t, place)


__all__ = [
    "GATHER_ROUNDS",
    "Hypotheses",
    "HypothesisConfig",
    "Places",
    "best_of_each_place",
    "distinct",
    "find_places",
    "gather",
    "kabsch",
    "propose",
]
