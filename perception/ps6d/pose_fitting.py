"""Pose voting by all votes of a category: measured points laid on predicted CAD coordinates by robust least squares.

The paper takes the rotation of one vote and the mean of the centres. One predicted rotation is off by a degree or two,
more than the tolerance on a large workpiece. Each vote also says where on the CAD its point lies, and a weighted Kabsch
fit (Kabsch 1976) of hundreds of such pairs averages their errors. Rounds alternate between the nearest symmetric copy
of each coordinate, Cauchy weights, and the fit. Then each vote goes to the pose that explains it best, so that
neighbours that were clustered together come apart, and every pose is fitted again. The depth image is not used.

Lengths are in units (`Workpiece.unit`), positions in camera coordinates.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from pickproof.cell.config import Config
from pickproof.cell.frames import Array
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import Categories, Ints, Modes, category_of_votes, nearest_rotations

WIDE, SCALE = (0.1, 0.05), 0.02
"""Cauchy scales: of the first rounds, as the voted rotation is off, and of the rest: the error of a coordinate."""
ROUNDS, STILL = 20, 2e-4
"""Rounds at SCALE at most, and the movement of a point at which they end: symmetric copies let a fit slide slowly."""


class FitConfig(Config):
    """Settings of the fit; lengths in units."""

    reach: float = Field(0.06, gt=0, description="distance up to which a vote agrees with a pose")
    reassign: int = Field(2, ge=0, description="times that votes are handed to the pose that explains them best")
    min_votes: int = Field(6, ge=3, description="fewest votes of a pose")
    least_share: float = Field(0.3, ge=0, le=1, description="of the votes of a well visible instance (third quartile)")


def fit_categories(
    votes: Votes, modes: Modes, categories: Categories, symmetry: Symmetry, config: FitConfig
) -> Categories:
    """Categories with fitted poses, most votes first; those that are no instance of their own are left out.

    A pose is left out where others explain its votes better, or where it has less than `least_share` of the votes that
    a well visible instance has in this image: a workpiece of which so little is seen is not counted as visible.

    Raises:
        ValueError: the votes carry no CAD coordinates.
    """
    if votes.cad_coordinates is None:
        raise ValueError("votes without CAD coordinates cannot be fitted")
    of_vote = category_of_votes(modes, categories.of_mode)
    poses = [
        fit_pose(votes.select(of_vote == c), categories.rotations[c], categories.positions[c], symmetry)
        for c in range(len(categories.counts))
    ]
    for _ in range(config.reassign):
        poses, of_vote = _hand_out(votes, poses, symmetry, config)
    return _kept(votes, poses, of_vote, symmetry, config)


def fit_pose(
    votes: Votes, R: Array, t: Array, symmetry: Symmetry, wide: tuple[float, ...] = WIDE
) -> tuple[Array, Array]:
    """Rotation (3, 3) and position (3,) fitted to all votes from a first guess; `wide` are the scales to begin with."""
    coordinates = votes.cad_coordinates
    assert coordinates is not None
    before = coordinates @ R.T + t
    for scale in (*wide, *[SCALE] * ROUNDS):
        nearest, distance = nearest_copies(coordinates, (votes.points - t) @ R, symmetry)
        R, t = kabsch(votes.points, nearest, 1.0 / (1.0 + np.square(distance / scale)))
        now = nearest @ R.T + t
        if scale == SCALE and np.abs(now - before).max() < STILL:
            break
        before = now
    return R, t


def kabsch(points: Array, coordinates: Array, weights: Array) -> tuple[Array, Array]:
    """R (3, 3) and t (3,) with least sum of weights (m,) times |points - (R coordinates + t)|^2, both (m, 3)."""
    share = weights / weights.sum()
    middle, origin = share @ points, share @ coordinates
    R = nearest_rotations(((points - middle).T @ ((coordinates - origin) * share[:, None]))[None])[0]
    return R, middle - R @ origin


def nearest_copies(coordinates: Array, seen: Array, symmetry: Symmetry) -> tuple[Array, Array]:
    """Symmetric copy of each CAD coordinate (m, 3) nearest to where its point is seen (m, 3), and the distance (m,).

    With infinite symmetry the copies of a coordinate are a circle about the axis, of a sphere's the sphere through it.
    """
    if symmetry.is_sphere:
        nearest = seen * (_norms(coordinates) / np.maximum(_norms(seen), 1e-9))[:, None]
        return nearest, _norms(nearest - seen)
    best, least = coordinates, np.full(len(coordinates), np.inf)
    for s in symmetry.S:
        copies = coordinates @ s.T
        if symmetry.infinite_axis is not None:
            copies = _turned(copies, seen, symmetry.infinite_axis)
        distance = _norms(copies - seen)
        nearer = distance < least
        best, least = np.where(nearer[:, None], copies, best), np.where(nearer, distance, least)
    return best, least


def _hand_out(
    votes: Votes, poses: list[tuple[Array, Array]], symmetry: Symmetry, config: FitConfig
) -> tuple[list[tuple[Array, Array]], Ints]:
    """Poses that explain votes of their own, fitted to the votes they explain best; and the pose (m,) of each vote."""
    distances = _distances(votes, poses, symmetry)
    alive = _claimants(distances < config.reach, config.min_votes)
    of_vote = _best(distances[alive], config.reach)
    again = []
    for k, i in enumerate(alive):
        own = of_vote == k
        enough = own.sum() >= config.min_votes
        again.append(fit_pose(votes.select(own), *poses[i], symmetry, ()) if enough else poses[i])
    return again, of_vote


def _claimants(agrees: np.ndarray, least: int) -> list[int]:
    """Poses (of n, m votes agreeing), most agreement first, that explain `least` votes no earlier one explains."""
    free = np.ones(agrees.shape[1], dtype=bool)
    alive = []
    for i in np.argsort(-agrees.sum(1), kind="stable"):
        own = free & agrees[i]
        if own.sum() >= least:
            alive.append(int(i))
            free &= ~own
    return alive


def _kept(
    votes: Votes, poses: list[tuple[Array, Array]], of_vote: Ints, symmetry: Symmetry, config: FitConfig
) -> Categories:
    counts = np.bincount(of_vote[of_vote >= 0], minlength=len(poses)).astype(np.int64)
    if not len(poses):
        return Categories.none()
    visible = config.least_share * np.quantile(counts, 0.75)
    order = [i for i in np.argsort(-counts, kind="stable") if counts[i] >= max(visible, config.min_votes)]
    R = np.array([poses[i][0] for i in order]).reshape(-1, 3, 3)
    t = np.array([poses[i][1] for i in order]).reshape(-1, 3)
    distances = _distances(votes, [poses[i] for i in order], symmetry)
    errors = np.array([np.minimum(distances[k][of_vote == i], 0.3).mean() for k, i in enumerate(order)])
    return Categories(t, R, counts[order], errors, np.zeros(0, dtype=np.int64))


def _distances(votes: Votes, poses: list[tuple[Array, Array]], symmetry: Symmetry) -> Array:
    """(n, m) distance of each vote's CAD coordinate to where each pose sees its point."""
    coordinates = votes.cad_coordinates
    assert coordinates is not None
    rows = [nearest_copies(coordinates, (votes.points - t) @ R, symmetry)[1] for R, t in poses]
    return np.array(rows).reshape(len(poses), len(votes))


def _best(distances: Array, reach: float) -> Ints:
    """Row (m,) of the least distance (n, m) of each vote, -1 beyond `reach`."""
    if not len(distances):
        return np.full(distances.shape[1], -1, dtype=np.int64)
    return np.where(distances.min(0) < reach, distances.argmin(0), -1).astype(np.int64)


def _turned(copies: Array, seen: Array, axis: int) -> Array:
    """Coordinates (m, 3) turned about an axis through the origin to the side of it where their points are seen."""
    across = [i for i in range(3) if i != axis]
    turned = copies.copy()
    radius, off = _norms(copies[:, across]), seen[:, across]
    turned[:, across] = off * (radius / np.maximum(_norms(off), 1e-9))[:, None]
    return turned


def _norms(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=1))
