"""Layers of the PS6D network: grouping, attention among neighbours, and interpolation.

Rows are points, columns features; an index (m, k) names k neighbours of each of m points.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional


def gather(rows: Tensor, index: Tensor) -> Tensor:
    """Rows (n, k, c) of a table (m, c); `index_select`, whose gradient is 2 to 3 times faster than indexing's."""
    return rows.index_select(0, index.reshape(-1)).view(*index.shape, rows.shape[1])


def turn(vectors: Tensor, frames: Tensor) -> Tensor:
    """F^T v, of (n, k, 3 j) vectors in groups of three and frames (n, 3, 3)."""
    n, k, c = vectors.shape
    return torch.bmm(vectors.view(n, k * c // 3, 3), frames).view(n, k, c)


class MaxOverNeighbours(torch.autograd.Function):
    """Maximum over k of (n, k, c); the gradient of `amax` counts ties and takes half as long again."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        """(n, c) of x (n, k, c)."""
        largest = x.amax(dim=1)
        ctx.save_for_backward(x, largest)
        return largest

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        """Gradient (n, k, c) of a gradient (n, c): to every neighbour that has the maximum."""
        x, largest = ctx.saved_tensors
        return (x == largest[:, None]) * gradient[:, None]


class NarrowLinear(nn.Linear):
    """Linear from few channels: the gradient of the weight as x^T g, three times faster here than g^T x."""

    def forward(self, x: Tensor) -> Tensor:
        """(..., out) of x (..., in)."""
        flat = x.reshape(-1, x.shape[-1])
        return torch.addmm(self.bias, flat, self.weight.t().contiguous()).view(*x.shape[:-1], self.out_features)


class Mlp(nn.Module):
    """Linear, BatchNorm over points, ReLU, Linear.

    `norm=False` leaves BatchNorm out: inside the attention, over points times neighbours, it took a third of a step.
    """

    def __init__(self, inside: int, hidden: int, out: int, norm: bool = True) -> None:
        super().__init__()
        self.first = (NarrowLinear if inside <= 12 else nn.Linear)(inside, hidden)
        self.second = nn.Linear(hidden, out)
        self.norm = nn.BatchNorm1d(hidden) if norm else None

    def forward(self, x: Tensor) -> Tensor:
        """(n, out) of x (n, in)."""
        y = self.first(x)
        return self.second(torch.relu_(self.norm(y) if self.norm is not None else y))


class SetAbstraction(nn.Module):
    """PointNet++ set abstraction: an MLP over each centre's neighbours and a maximum over them."""

    def __init__(self, features: int, geometry: int, out: int) -> None:
        super().__init__()
        self.geometry = NarrowLinear(geometry, out)
        self.features = nn.Linear(features, out, bias=False) if features else None
        self.norm, self.second, self.after = nn.BatchNorm1d(out), nn.Linear(out, out), nn.BatchNorm1d(out)

    def forward(self, features: Tensor | None, geometry: Tensor, index: Tensor) -> Tensor:
        """(n, out) of the finer level's features, the geometry (n, k, g) and indices (n, k) of its neighbours."""
        x = self.geometry(geometry)
        if self.features is not None and features is not None:
            x = x + gather(self.features(features), index)
        n, k, c = x.shape
        x = torch.relu_(self.norm(x.view(n * k, c)))
        return torch.relu_(self.after(MaxOverNeighbours.apply(self.second(x).view(n, k, c))))


class MultiScaleGrouping(nn.Module):
    """Set abstraction at two scales side by side, features concatenated (PointNet++, Qi et al. 2017, sec. 3.3)."""

    def __init__(self, features: int, geometry: int, out: int) -> None:
        super().__init__()
        self.near, self.far = SetAbstraction(features, geometry, out), SetAbstraction(features, geometry, out)

    def forward(
        self, features: Tensor | None, geometries: tuple[Tensor, Tensor], indices: tuple[Tensor, Tensor]
    ) -> Tensor:
        """(n, 2 * out): as `SetAbstraction`, for near and for far neighbours."""
        near, far = self.near(features, geometries[0], indices[0]), self.far(features, geometries[1], indices[1])
        return torch.cat([near, far], dim=1)


class PointTransformerBlock(nn.Module):
    """Vector attention over k neighbours with a residual (Point Transformer, eq. 3)."""

    def __init__(self, c: int, geometry: int) -> None:
        super().__init__()
        self.before = nn.Linear(c, c)
        self.before_norm = nn.BatchNorm1d(c)
        self.q, self.k, self.v = nn.Linear(c, c), nn.Linear(c, c), nn.Linear(c, c)
        self.position = Mlp(geometry, c // 2, c, norm=False)
        self.weights = Mlp(c, c // 4, c // 4, norm=False)
        self.norm, self.after, self.after_norm = nn.BatchNorm1d(c), nn.Linear(c, c), nn.BatchNorm1d(c)

    def forward(self, x: Tensor, geometry: Tensor, index: Tensor) -> Tensor:
        """(n, c) of x (n, c), the geometry (n, k, g) and indices (n, k) of its neighbours."""
        n, k = index.shape
        y = torch.relu_(self.before_norm(self.before(x)))
        hidden = torch.relu_(self.position.first(geometry))
        value = (gather(self.v(y), index) + self.position.second(hidden)).view(n, k, 4, -1)
        # channels share weights in 4 groups, as published
        y = (value * self._attention(y, hidden, index)[:, :, None]).sum(1).view(n, -1)
        return torch.relu(x + self.after_norm(self.after(torch.relu_(self.norm(y)))))

    def _attention(self, y: Tensor, hidden: Tensor, index: Tensor) -> Tensor:
        """softmax(weights(k_j - q_i + delta)), (n, k, c / 4), delta = position.second(hidden).

        The first layer of `weights` is linear and is taken of each term alone, which leaves a quarter of the channels.
        """
        first, position = self.weights.first, self.position.second
        k, q = functional.linear(self.k(y), first.weight), functional.linear(self.q(y), first.weight)
        delta = functional.linear(hidden, first.weight @ position.weight, first(position.bias))
        weights = self.weights.second(torch.relu_(delta + gather(k, index) - q[:, None]))
        return torch.softmax(weights, dim=1)


class FeaturePropagation(nn.Module):
    """Features of a coarse level carried to a finer one, seen from the fine points' frames, plus a skip connection."""

    def __init__(self, coarse: int, fine: int, geometry: int, out: int) -> None:
        super().__init__()
        self.coarse, self.geometry = nn.Linear(coarse, out), NarrowLinear(geometry, out)
        self.merge = Mlp(out + fine, out, out)
        self.norm = nn.BatchNorm1d(out)

    def forward(self, coarse: Tensor, fine: Tensor, geometry: Tensor, index: Tensor, weights: Tensor) -> Tensor:
        """(n, out) of the coarse level's features, and of the fine level's (n, c) with k neighbours each."""
        x = torch.relu_(gather(self.coarse(coarse), index) + self.geometry(geometry))
        x = (x * weights[..., None]).sum(1)
        return torch.relu_(self.norm(self.merge(torch.cat([x, fine], dim=1))))
