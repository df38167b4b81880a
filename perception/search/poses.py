"""Poses with what ranks them, and which of them are one and the same."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import torch
from torch import Tensor

from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.perception.cad.shape_model import ShapeModel

_GENERIC = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
"""A rotation near no symmetry axis, to which equal poses are turned."""


@dataclass(frozen=True)
class Poses:
    """Poses to be looked at: rotations (h, 3, 3), positions (h, 3) in units, scores (h,)."""

    rotations: Tensor
    positions: Tensor
    scores: np.ndarray

    def __len__(self) -> int:
        return len(self.scores)

    @staticmethod
    def none() -> Poses:
        """No poses."""
        return Poses(torch.zeros(0, 3, 3), torch.zeros(0, 3), np.zeros(0, np.float32))

    def select(self, index: np.ndarray) -> Poses:
        """The poses at `index`."""
        i = torch.from_numpy(np.ascontiguousarray(index))
        return Poses(self.rotations[i].contiguous(), self.positions[i].contiguous(), self.scores[index])

    def join(self, other: Poses) -> Poses:
        """These poses, then others."""
        return Poses(
            torch.cat([self.rotations, other.rotations]),
            torch.cat([self.positions, other.positions]),
            np.concatenate([self.scores, other.scores]),
        )

    def distinct(self, shape: ShapeModel, apart: float, most: int | None = None) -> Poses:
        """Best score first, those that no better one is nearer to than `apart`, in units; `most` at most."""
        return self.select(self.distinct_index(shape, apart, most))

    def distinct_index(self, shape: ShapeModel, apart: float, most: int | None = None) -> np.ndarray:
        """Indices of `distinct`.

        The distance of two poses is that of `ShapeModel.embed`, with the offset of their positions beside.
        """
        turned = shape.embed(self.rotations.numpy().astype(np.float64))
        places = np.concatenate([self.positions.numpy(), turned], axis=1)
        order = np.argsort(-self.scores, kind="stable")
        limit = len(order) if most is None else most
        kept = _first_of_each(places[order].astype(np.float32), np.float32(apart**2), limit)
        return np.asarray(order[kept])


def turned_alike(rotations: np.ndarray, symmetry: Symmetry) -> np.ndarray:
    """Rotations (h, 3, 3), each turned by the symmetry that brings it nearest to one fixed rotation.

    Two poses that look alike thereby become equal, but at the border between two such turns.
    """
    if len(symmetry.S) == 1:
        return rotations
    # trace(G^T R s) is largest where R s is nearest to G
    traces = np.einsum("ij,hik,skj->hs", _GENERIC, rotations, symmetry.S)
    return np.asarray(np.einsum("hij,hjk->hik", rotations, symmetry.S[traces.argmax(1)]))


@numba.njit(cache=True)
def _first_of_each(places, square_apart, most):  # type: ignore[no-untyped-def]
    """Indices of the first rows of places (n, d), `most` at most, that are at least that far from every kept one."""
    kept = np.empty(min(len(places), most), np.int64)
    count = 0
    for i in range(len(places)):
        if count == most:
            break
        new = True
        for k in range(count):
            square = np.float32(0.0)
            for d in range(places.shape[1]):
                offset = places[i, d] - places[kept[k], d]
                square += offset * offset
                if square >= square_apart:
                    break
            if square < square_apart:
                new = False
                break
        if new:
            kept[count] = i
            count += 1
    return kept[:count]
