"""Two-stage clustering and pose voting (PS6D, sec. III-F).

Stage 1 clusters votes by position and rotation together, so crossing workpieces come apart; a workpiece with finite
symmetry gives one mode per symmetry. Stage 2 clusters the modes by position alone, with a smaller bandwidth and more
votes, so the modes of one workpiece become one category. Pose voting takes the rotation with the smallest error in
the category.

Rotations enter as R C, C the root of the CAD's second moment: the distance of two embedded rotations is a root mean
square distance of surface points (Bregier et al. 2018), a length like the distance of two positions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from pickproof.cell.config import Config
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.ps6d.votes import Votes

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class ClusterConfig(Config):
    """Bandwidths in units, `Workpiece.unit`."""

    two_stage: bool = Field(True, description="false: stage 1 only, each mode is an instance (ablation)")
    position_bandwidth: float = Field(0.12, gt=0, description="h_p of stage 1")
    rotation_bandwidth: float = Field(0.20, gt=0, description="h_r of stage 1")
    merge_bandwidth: float = Field(0.08, gt=0, description="of stage 2, position only")
    min_votes_mode: float = Field(3, gt=0, description="fewest votes of a mode of stage 1, per 1,000 votes")
    min_votes: float = Field(6, gt=0, description="fewest votes of a category of stage 2, per 1,000 votes")
    seeds: int = Field(512, ge=1, description="mean shift starts at this many votes, evenly spaced")
    sample: int = Field(1500, ge=1, description="votes that make up the density, evenly spaced; all are assigned")
    iterations: int = Field(15, ge=1, description="of mean shift")


@dataclass(frozen=True)
class Modes:
    """Clusters of stage 1, most votes first.

    Attributes:
        positions: (k, 3) mean predicted centre; rotations: (k, 3, 3) chordal mean rotation.
        counts: (k,) votes; labels: (m,) mode of each vote, -1 for none.
    """

    positions: Floats
    rotations: Floats
    counts: Ints
    labels: Ints

    @staticmethod
    def none(votes: int) -> Modes:
        """No modes among `votes` votes."""
        empty = np.zeros(0, dtype=np.int64)
        return Modes(np.zeros((0, 3)), np.zeros((0, 3, 3)), empty, np.full(votes, -1, dtype=np.int64))


@dataclass(frozen=True)
class Categories:
    """Instances after stage 2 and pose voting, most votes first.

    Attributes:
        positions: (n, 3); rotations: (n, 3, 3) the voted ones; counts: (n,) votes; errors: (n,) the mean distance of
            the other votes to the voted rotation, in units.
        of_mode: (k,) category of each mode, -1 for none.
    """

    positions: Floats
    rotations: Floats
    counts: Ints
    errors: Floats
    of_mode: Ints

    @staticmethod
    def none() -> Categories:
        """No categories."""
        empty = np.zeros(0, dtype=np.int64)
        return Categories(np.zeros((0, 3)), np.zeros((0, 3, 3)), empty, np.zeros(0), empty)


def cluster(votes: Votes, shape: ShapeModel, config: ClusterConfig) -> tuple[Modes, Categories]:
    """Both stages and pose voting."""
    modes = find_modes(votes, shape, config)
    folded = shape.fold(modes.positions, modes.rotations, votes.middle)
    return modes, vote(votes, modes, merge(modes, folded, config), shape)


def find_modes(votes: Votes, shape: ShapeModel, config: ClusterConfig) -> Modes:
    """Stage 1: mean shift on position and rotation together."""
    centres = shape.fold(votes.centres, votes.rotations, votes.middle)
    features = np.concatenate(
        [centres / config.position_bandwidth, shape.embed(votes.rotations) / config.rotation_bandwidth], axis=1
    )
    peaks = mean_shift(evenly(features, config.sample), config.seeds, config.iterations)
    labels = _assign(features, peaks)
    counts = np.bincount(labels[labels >= 0], minlength=len(peaks)).astype(np.int64)
    order = np.argsort(-counts, kind="stable")
    order = order[counts[order] >= least_votes(config.min_votes_mode, len(votes))]
    renumber = np.full(len(peaks) + 1, -1, dtype=np.int64)
    renumber[order] = np.arange(len(order))
    labels = renumber[labels]
    members = labels >= 0
    positions = group_sums(votes.centres[members], labels[members], len(order)) / np.maximum(counts[order], 1)[:, None]
    sums = group_sums(votes.rotations[members].reshape(-1, 9), labels[members], len(order))
    return Modes(positions, nearest_rotations(sums.reshape(-1, 3, 3)), counts[order], labels)


def merge(modes: Modes, positions: Floats, config: ClusterConfig) -> Ints:
    """Stage 2 on positions (k, 3): category (k,) of each mode, -1 where one has too few votes; by falling votes."""
    k = len(modes.counts)
    least = least_votes(config.min_votes, len(modes.labels))
    if k == 0 or not config.two_stage:
        return np.where(modes.counts >= least, np.arange(k), -1)
    features = positions / config.merge_bandwidth
    labels = _assign(features, mean_shift(features, k, config.iterations, modes.counts), limit=np.inf)
    counts = np.bincount(labels, weights=modes.counts)
    order = np.argsort(-counts, kind="stable")
    order = order[counts[order] >= least]
    renumber = np.full(len(counts), -1, dtype=np.int64)
    renumber[order] = np.arange(len(order))
    return renumber[labels]


def vote(votes: Votes, modes: Modes, of_mode: Ints, shape: ShapeModel) -> Categories:
    """Pose voting: in each category the member rotation with the smallest mean error to all its votes.

    The error of two rotations is their embedded distance, least over the symmetries of the workpiece; it is cut at
    the size of the part so that outliers weigh alike. The position is the mean over the category.
    """
    n = int(of_mode.max(initial=-1)) + 1
    of_vote = category_of_votes(modes, of_mode)
    positions, rotations = np.zeros((n, 3)), np.zeros((n, 3, 3))
    counts, errors = np.zeros(n, dtype=np.int64), np.zeros(n)
    for c in range(n):
        members = np.flatnonzero(of_vote == c)
        positions[c] = votes.centres[members].mean(0)
        counts[c] = len(members)
        candidates = members[:: max(1, len(members) // 64)]
        R = votes.rotations[candidates]
        all_embedded = shape.embed(R)
        distance = np.stack([square_distances(shape.embed(R @ s), all_embedded) for s in shape.symmetry.S]).min(0)
        mean_error = np.minimum(np.sqrt(distance), 0.3).mean(1)
        best = int(mean_error.argmin())
        rotations[c], errors[c] = R[best], mean_error[best]
    return Categories(positions, rotations, counts, errors, of_mode)


def category_of_votes(modes: Modes, of_mode: Ints) -> Ints:
    """Category (m,) of each vote, -1 for none."""
    return np.where(modes.labels >= 0, np.append(of_mode, -1)[modes.labels], -1)


def evenly(x: Any, n: int) -> Any:
    """At most n rows of an array or tensor, evenly spaced."""
    return x if len(x) <= n else x[np.linspace(0, len(x) - 1, n).round().astype(np.int64)]


def least_votes(per_thousand: float, votes: int) -> float:
    """A threshold given per 1,000 votes, for a number of votes; not below what it says for 1,000."""
    return per_thousand * max(1.0, votes / 1000)


def mean_shift(features: np.ndarray, seeds: int, iterations: int, weights: np.ndarray | None = None) -> np.ndarray:
    """Peaks (k, d) of the density of features (m, d) under a flat kernel of radius 1, densest first.

    Starts at `seeds` of the points, evenly spaced in their order; peaks nearer than 1 to a denser one are dropped.
    """
    if len(features) == 0:
        return features
    # distances come from products, so the origin must be near or float32 loses its digits
    middle = features.mean(0)
    x = torch.from_numpy((features - middle).astype(np.float32))
    w = torch.ones(len(x)) if weights is None else torch.from_numpy(weights.astype(np.float32))
    data = torch.cat([x * w[:, None], w[:, None]], 1)
    half_square = 0.5 * x.square().sum(1)
    y = evenly(x, seeds).clone()
    density = torch.zeros(len(y))
    active = torch.arange(len(y))
    for _ in range(iterations):
        z = y[active]
        # |z - x|^2 < 1
        near = (z @ x.T).sub_(half_square).gt(0.5 * z.square().sum(1, keepdim=True) - 0.5)
        total = near.float() @ data
        density[active] = total[:, -1]
        shifted = total[:, :-1] / total[:, -1:].clamp(min=1e-6)
        moved = (shifted - z).norm(dim=1) > 1e-3
        y[active] = shifted
        active = active[moved]
        if len(active) == 0:
            break
    order = torch.argsort(density, descending=True, stable=True)
    y = y[order]
    gaps = torch.cdist(y, y, compute_mode="donot_use_mm_for_euclid_dist").numpy() < 1.0
    free = np.ones(len(y), dtype=bool)
    peaks = []
    for i in range(len(y)):
        if free[i]:
            peaks.append(i)
            free &= ~gaps[i]
    return np.asarray(y[peaks].numpy().astype(np.float64) + middle)


def nearest_rotations(M: np.ndarray) -> np.ndarray:
    """Rotations (k, 3, 3) nearest to matrices (k, 3, 3): the chordal mean where M is a sum of rotations."""
    U, _, Vt = np.linalg.svd(M)
    U[..., :, 2] *= np.linalg.det(U @ Vt)[..., None]
    return np.asarray(U @ Vt)


def square_distances(a: Floats, b: Floats) -> Floats:
    """|a_i - b_j|^2 (n, m) of rows (n, d) and (m, d)."""
    square = (a**2).sum(1)[:, None] - 2 * (a @ b.T) + (b**2).sum(1)
    return np.asarray(np.maximum(square, 0.0, out=square))


def group_sums(values: Floats, labels: Ints, n: int) -> Floats:
    """Sums (n, d) of the rows (m, d) of each label (m,)."""
    return np.stack([np.bincount(labels, weights=column, minlength=n) for column in values.T], axis=1)


def _assign(features: np.ndarray, peaks: np.ndarray, limit: float = 1.0) -> Ints:
    """Nearest peak (m,) of each feature vector, -1 beyond `limit`."""
    if len(features) == 0:
        return np.zeros(0, dtype=np.int64)
    square = square_distances(features, peaks)
    best = square.argmin(1)
    within = square[np.arange(len(features)), best] <= limit**2
    return np.where(within, best, -1).astype(np.int64)
