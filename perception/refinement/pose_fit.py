"""Poses fitted to predicted CAD coordinates: measured = R model + t in least squares.

Takes points with the CAD coordinates that the network predicted for them; gives rotations and positions. `kabsch` fits
one pose to each group of points; `gather` lets each of many poses find the votes that agree with it.
"""

from __future__ import annotations

import numpy as np
import torch

from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.ps6d.voting import group_sums, nearest_rotations

GATHER_ROUNDS = (0.3, 0.2, 0.12, 0.08)
"""Distances in units within which a predicted CAD coordinate belongs to a pose, one a round."""
FEWEST_VOTES = 8
"""Votes within reach that a pose is fitted to, at least."""


def kabsch(model: np.ndarray, measured: np.ndarray, groups: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (count, 3, 3) and translations (count, 3) with measured = R model + t in least squares (Kabsch 1976).

    One for each group of points (m, 3), whose numbers are `groups` (m,); none may be empty.
    """
    n = np.bincount(groups, minlength=count)[:, None]
    a, b = group_sums(model, groups, count) / n, group_sums(measured, groups, count) / n
    away = (measured - b[groups])[:, :, None] * (model - a[groups])[:, None]
    R = nearest_rotations(group_sums(away.reshape(-1, 9), groups, count).reshape(-1, 3, 3))
    return R, b - (R @ a[..., None])[..., 0]


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
        Rs, ts = _refitted(Rs, ts, terms, axis, shape.length, reach)
    return Rs.numpy().astype(np.float64), ts.numpy().astype(np.float64) + middle


def _refitted(
    R: torch.Tensor, t: torch.Tensor, terms: list[torch.Tensor], axis: torch.Tensor, length: float, reach: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """One round of `gather`: each pose fitted to the votes within `reach`; one with few of them stays as it is.

    `terms` has one (m, 17) for every symmetry of the part; a vote counts under that which fits it best.
    """
    square = [_square_distances(R, t, term, axis, length) for term in terms]
    least = torch.stack(square).amin(0) if len(square) > 1 else square[0]
    weight = (1 - least / reach**2).clamp_(min=0)
    parts = [torch.where(own == least, weight, 0.0) for own in square] if len(square) > 1 else [weight]
    moments = torch.stack([part @ term for part, term in zip(parts, terms, strict=True)]).sum(0)
    total = moments[:, :1].clamp(min=1e-6)
    b, a = moments[:, 1:4] / total, moments[:, 4:7] / total
    cross = moments[:, 7:16].view(-1, 3, 3) - total[..., None] * b[:, :, None] * a[:, None]
    fitted = torch.from_numpy(nearest_rotations(cross.numpy()))
    enough = (weight > 0).sum(1) >= FEWEST_VOTES
    R = torch.where(enough[:, None, None], fitted, R)
    return R, torch.where(enough[:, None], b - (R @ a[..., None])[..., 0], t)


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
