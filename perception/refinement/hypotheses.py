"""From clusters to pose hypotheses, and from thousands of them to the few per place that deserve ICP."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from pydantic import Field

from pickproof.cell.config import Config
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import (
    Categories,
    Modes,
    evenly,
    group_sums,
    least_votes,
    mean_shift,
    nearest_rotations,
    square_distances,
)
from pickproof.perception.refinement.depth_agreement import soft_score
from pickproof.perception.refinement.depth_surface import SurfaceMap


class HypothesisConfig(Config):
    """Where hypotheses come from and how many are kept."""

    place_bandwidth: float = Field(0.12, gt=0, description="of the search for places by position alone, in units")
    min_votes_place: float = Field(4, gt=0, description="fewest votes of such a place, per 1,000 votes")
    max_places: int = Field(80, ge=1, description="places tried, those with most votes")
    votes_per_place: int = Field(8, ge=0, description="single predicted rotations tried at each place")
    near_symmetries: bool = Field(True, description="turn each hypothesis by the near symmetries of the CAD")
    slide_reach: float = Field(0.25, ge=0, description="how far slender parts are shifted along their axis, in units")
    slide_step: float = Field(0.05, gt=0, description="in units")
    gather_votes: int = Field(
        500, ge=8, description="votes, evenly spaced, to which hypotheses of compact parts are fitted"
    )
    keep: int = Field(6, ge=1, description="hypotheses of a place that go into coarse ICP")
    keep_after_coarse: int = Field(2, ge=1, description="hypotheses of a place that go into fine ICP")
    tolerance: float = Field(0.07, gt=0, description="of the score before ICP, in units")
    points: int = Field(64, ge=8, description="CAD points of that score")
    screen_points: int = Field(20, ge=8, description="CAD points of a first score, which keeps 4 x `keep` of a place")
    apart: float = Field(0.06, ge=0, description="two hypotheses of a place nearer than this, in units, are one")
    alike: float = Field(0.005, ge=0, description="the same before they are turned and scored, in units")
    slender: int = Field(3, ge=1, description="factor of votes_per_place, keep and keep_after_coarse on slender parts")

    def of(self, shape: ShapeModel) -> HypothesisConfig:
        """The settings for a workpiece."""
        if not shape.slender:
            return self
        names = ("votes_per_place", "keep", "keep_after_coarse")
        return self.model_copy(update={name: self.slender * getattr(self, name) for name in names})


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
    R, t, place = _candidates(votes, modes, categories, places, config)
    if votes.cad_coordinates is not None and shape.symmetry.infinite_axis is None:
        if shape.slender:
            R, t = gather(R, t, votes, shape, GATHER_ROUNDS)
        else:
            few = votes.select(evenly(np.arange(len(votes)), config.gather_votes))
            gathered = gather(R, t, few, shape, GATHER_ROUNDS[1:])
            R, t = np.concatenate([gathered[0], R]), np.concatenate([gathered[1], t])
            place = np.concatenate([place, place])
            few_of_each = best_of_each_place(_unscored(R, t, place), shape, len(R), config.alike)
            R, t, place = R[few_of_each], t[few_of_each], place[few_of_each]
    if config.near_symmetries:
        near = shape.near_symmetries
        R = np.einsum("hij,sjk->hsik", R, near).reshape(-1, 3, 3)
        t, place = np.repeat(t, len(near), axis=0), np.repeat(place, len(near))
    R, t, place = _slide(R, t, place, shape, config)
    tolerance = config.tolerance * shape.fineness
    Rs, ts = torch.from_numpy(R.astype(np.float32)), torch.from_numpy(t.astype(np.float32))
    scores = soft_score(Rs, ts, scene, shape, config.screen_points, tolerance).numpy()
    screened = Hypotheses(Rs, ts, place, scores)
    screened = screened.select(_top(place, scores, 4 * config.keep))
    scores = soft_score(screened.rotations, screened.positions, scene, shape, config.points, tolerance).numpy()
    scored = replace(screened, scores=scores)
    return scored.select(best_of_each_place(scored, shape, config.keep, config.apart))


def _unscored(R: np.ndarray, t: np.ndarray, place: np.ndarray) -> Hypotheses:
    return Hypotheses(torch.from_numpy(R), torch.from_numpy(t), place, np.zeros(len(R)))


def _top(places: np.ndarray, scores: np.ndarray, keep: int) -> np.ndarray:
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
        kept.append(best[_unlike(embedded[best], apart, keep)])
    return np.concatenate(kept) if kept else np.zeros(0, dtype=np.int64)


def distinct(R: torch.Tensor, t: torch.Tensor, scores: np.ndarray, shape: ShapeModel, apart: float) -> np.ndarray:
    """Indices, best score first, of poses that no better one is nearer to than `apart`, whatever their place."""
    embedded = np.concatenate([t.numpy(), shape.embed(R.numpy().astype(np.float64))], axis=1)
    order = np.argsort(-scores, kind="stable")
    return np.asarray(order[_unlike(embedded[order], apart)], dtype=np.int64)


def _unlike(x: np.ndarray, apart: float, most: int | None = None) -> list[int]:
    """Indices of the first rows of x (n, d), `most` at most, that are at least `apart` from every earlier one."""
    like = square_distances(x, x) < apart**2
    free = np.ones(len(x), dtype=bool)
    kept: list[int] = []
    while free.any() and len(kept) != most:
        kept.append(int(free.argmax()))
        free &= ~like[kept[-1]]
        free[kept[-1]] = False
    return kept


def kabsch(model: np.ndarray, measured: np.ndarray, groups: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (count, 3, 3) and translations (count, 3) with measured = R model + t in least squares (Kabsch 1976).

    One for each group of points (m, 3), whose numbers are `groups` (m,); none may be empty.
    """
    n = np.bincount(groups, minlength=count)[:, None]
    a, b = group_sums(model, groups, count) / n, group_sums(measured, groups, count) / n
    away = (measured - b[groups])[:, :, None] * (model - a[groups])[:, None]
    R = nearest_rotations(group_sums(away.reshape(-1, 9), groups, count).reshape(-1, 3, 3))
    return R, b - (R @ a[..., None])[..., 0]


def _candidates(
    votes: Votes, modes: Modes, categories: Categories, places: Places, config: HypothesisConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotations, positions and places: voted poses, mode averages, Kabsch of modes and places, single votes."""
    in_place = np.flatnonzero(places.of_mode >= 0)
    R = [categories.rotations, modes.rotations[in_place]]
    t = [categories.positions, modes.positions[in_place]]
    place = [np.arange(len(categories.counts)), places.of_mode[in_place]]
    for c, position in enumerate(places.positions):
        members = np.flatnonzero(places.of_vote == c)
        if config.votes_per_place and len(members):
            few = members[np.unique(np.linspace(0, len(members) - 1, config.votes_per_place).round().astype(int))]
            R.append(votes.rotations[few])
            t.append(np.broadcast_to(position, (len(few), 3)))
            place.append(np.full(len(few), c))
    if votes.cad_coordinates is not None:
        of_modes = np.append(places.of_mode, -1)[modes.labels]
        for labels, place_of in (
            (np.where(of_modes >= 0, modes.labels, -1), places.of_mode),
            (places.of_vote, np.arange(len(places.positions))),
        ):
            enough = np.flatnonzero(np.bincount(labels[labels >= 0], minlength=len(place_of)) >= 4)
            renumber = np.full(len(place_of) + 1, -1)
            renumber[enough] = np.arange(len(enough))
            groups = renumber[labels]
            mine = groups >= 0
            poses = kabsch(votes.cad_coordinates[mine], votes.points[mine], groups[mine], len(enough))
            R.append(poses[0])
            t.append(poses[1])
            place.append(place_of[enough])
    return np.concatenate(R), np.concatenate(t), np.concatenate(place)


GATHER_ROUNDS = (0.3, 0.2, 0.12, 0.08)
"""Distances in units within which a predicted CAD coordinate belongs to a pose, one a round."""


def gather(
    R: np.ndarray, t: np.ndarray, votes: Votes, shape: ShapeModel, rounds: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Poses (h, 3, 3), (h, 3) fitted to the votes that agree with them, wherever on the part these lie.

    A direction comes from points far apart rather than from any single vote: in each round the votes whose CAD
    coordinates the pose carries within its reach, in units, of their points take part, at the symmetry that fits best.
    Errors along a slender part, where predictions scatter, count less.
    """
    assert votes.cad_coordinates is not None
    # products of thousands of poses and votes: every distance and every moment is linear in these terms of a vote
    middle = votes.points.mean(0) if len(votes) else np.zeros(3)
    p, axis = (torch.from_numpy(x.astype(np.float32)) for x in (votes.points - middle, shape.long_axis))
    models = [torch.from_numpy((votes.cad_coordinates @ s.T).astype(np.float32)) for s in shape.symmetry.S]
    terms = [_terms(p, model) for model in models]
    Rs, ts = torch.from_numpy(R.astype(np.float32)), torch.from_numpy((t - middle).astype(np.float32))
    for reach in rounds:
        square = [_square_distances(Rs, ts, term, axis, shape.length) for term in terms]
        least = torch.stack(square).amin(0) if len(square) > 1 else square[0]
        weight = (1 - least / reach**2).clamp_(min=0)
        parts = [torch.where(own == least, weight, 0.0) for own in square] if len(square) > 1 else [weight]
        moments = torch.stack([part @ term for part, term in zip(parts, terms, strict=True)]).sum(0)
        total = moments[:, :1].clamp(min=1e-6)
        b, a = moments[:, 1:4] / total, moments[:, 4:7] / total
        cross = moments[:, 7:16].view(-1, 3, 3) - total[..., None] * b[:, :, None] * a[:, None]
        fitted = torch.from_numpy(nearest_rotations(cross.numpy()))
        enough = (weight > 0).sum(1) >= 8
        Rs = torch.where(enough[:, None, None], fitted, Rs)
        ts = torch.where(enough[:, None], b - (Rs @ a[..., None])[..., 0], ts)
    return Rs.numpy().astype(np.float64), ts.numpy().astype(np.float64) + middle


def _terms(p: torch.Tensor, m: torch.Tensor) -> torch.Tensor:
    """(m, 17): 1, p, m, p m^T and |p|^2 + |m|^2 of points p and CAD coordinates m, both (m, 3)."""
    products = (p[:, :, None] * m[:, None]).flatten(1)
    squares = (p.square() + m.square()).sum(1, keepdim=True)
    return torch.cat([torch.ones_like(squares), p, m, products, squares], dim=1)


def _square_distances(
    R: torch.Tensor, t: torch.Tensor, terms: torch.Tensor, axis: torch.Tensor, length: float
) -> torch.Tensor:
    """|R^T (p - t) - m|^2 (h, m) with what lies along the part's long axis divided by its length."""
    turned = (R.transpose(1, 2) @ t[..., None])[..., 0]
    one = torch.ones(len(R), 1)
    factors = torch.cat([t.square().sum(1, keepdim=True), -2 * t, 2 * turned, -2 * R.flatten(1), one], dim=1)
    along = torch.cat([-(turned @ axis)[:, None], R @ axis, -axis.expand(len(R), 3)], dim=1)
    return factors @ terms.T - (along @ terms[:, :7].T).square_().mul_(1 - 1 / length**2)


def _distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(square_distances(a, b)))


def _slide(
    R: np.ndarray, t: np.ndarray, place: np.ndarray, shape: ShapeModel, config: HypothesisConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hypotheses shifted along the axis of a slender part."""
    if not shape.slender or config.slide_reach == 0:
        return R, t, place
    n = round(config.slide_reach / config.slide_step)
    steps = config.slide_step * np.arange(-n, n + 1)
    shifted = t[:, None] + steps[None, :, None] * (R @ shape.long_axis)[:, None]
    return np.repeat(R, len(steps), axis=0), shifted.reshape(-1, 3), np.repeat(place, len(steps))
