"""From clusters to pose hypotheses, and from thousands of them to the few per place that deserve ICP."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from pydantic import Field

from cell.config import Config
from perception.agreement import soft_score
from perception.cluster import Categories, Modes, nearest_rotations
from perception.shape_model import ShapeModel
from perception.surface_map import SurfaceMap
from perception.votes import Votes


class HypothesisConfig(Config):
    """Where hypotheses come from and how many are kept."""

    votes_per_place: int = Field(12, ge=0, description="single predicted rotations tried at each place")
    near_symmetries: bool = Field(True, description="turn each hypothesis by the near symmetries of the CAD")
    slides: int = Field(0, ge=0, description="shifts by 0.1 units each way along the long axis (slender parts)")
    keep: int = Field(6, ge=1, description="hypotheses of a place that go into coarse ICP")
    tolerance: float = Field(0.07, gt=0, description="of the score before ICP, in units")
    points: int = Field(64, ge=8, description="CAD points of that score")
    apart: float = Field(0.06, ge=0, description="two hypotheses of a place nearer than this, in units, are one")


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


def propose(
    votes: Votes, modes: Modes, categories: Categories, scene: SurfaceMap, shape: ShapeModel, config: HypothesisConfig
) -> Hypotheses:
    """All hypotheses of all places, scored against the depth image; the best few of each place."""
    R, t, place = _candidates(votes, modes, categories, shape, config)
    if config.near_symmetries:
        near = shape.near_symmetries
        R = np.einsum("hij,sjk->hsik", R, near).reshape(-1, 3, 3)
        t, place = np.repeat(t, len(near), axis=0), np.repeat(place, len(near))
    R, t, place = _slide(R, t, place, shape, config.slides)
    Rs, ts = torch.from_numpy(R.astype(np.float32)), torch.from_numpy(t.astype(np.float32))
    scores = soft_score(Rs, ts, scene, shape, config.points, config.tolerance).numpy()
    every = Hypotheses(Rs, ts, place, scores)
    return every.select(best_of_each_place(every, shape, config.keep, config.apart))


def best_of_each_place(hypotheses: Hypotheses, shape: ShapeModel, keep: int, apart: float) -> np.ndarray:
    """Indices of the `keep` best hypotheses of each place that are at least `apart` from a better one there."""
    embedded = np.concatenate(
        [hypotheses.positions.numpy(), shape.embed(hypotheses.rotations.numpy().astype(np.float64))], axis=1
    )
    order = np.lexsort((-hypotheses.scores, hypotheses.places))
    bounds = np.flatnonzero(np.diff(hypotheses.places[order])) + 1
    kept = []
    for members in np.split(order, bounds):
        mine: list[int] = []
        for i in members[: 16 * keep]:
            if not mine or np.linalg.norm(embedded[mine] - embedded[i], axis=1).min() >= apart:
                mine.append(int(i))
                if len(mine) == keep:
                    break
        kept.extend(mine)
    return np.asarray(kept, dtype=np.int64)


def kabsch(model: np.ndarray, measured: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,) with measured = R model + t in the weighted least squares (Kabsch 1976)."""
    w = weights / weights.sum()
    a, b = w @ model, w @ measured
    R = nearest_rotations(((measured - b) * w[:, None]).T @ (model - a)[None])[0]
    return R, b - R @ a


def _candidates(
    votes: Votes, modes: Modes, categories: Categories, shape: ShapeModel, config: HypothesisConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotations, positions and places: voted poses, mode averages, Kabsch of modes, single votes."""
    of_vote = np.where(modes.labels >= 0, np.append(categories.of_mode, -1)[modes.labels], -1)
    in_place = np.flatnonzero(categories.of_mode >= 0)
    n = len(categories.counts)
    R = [categories.rotations, modes.rotations[in_place]]
    t = [categories.positions, modes.positions[in_place]]
    place = [np.arange(n), categories.of_mode[in_place]]
    for k in in_place if votes.cad_coordinates is not None else ():
        members = np.flatnonzero(modes.labels == k)
        if len(members) >= 4 and votes.cad_coordinates is not None:
            pose = kabsch(votes.cad_coordinates[members], votes.points[members], np.ones(len(members)))
            R.append(pose[0][None])
            t.append(pose[1][None])
            place.append(categories.of_mode[k : k + 1])
    for c in range(n if config.votes_per_place else 0):
        members = np.flatnonzero(of_vote == c)
        few = members[np.unique(np.linspace(0, len(members) - 1, config.votes_per_place).round().astype(int))]
        R.append(votes.rotations[few])
        t.append(np.broadcast_to(categories.positions[c], (len(few), 3)))
        place.append(np.full(len(few), c))
    return np.concatenate(R), np.concatenate(t), np.concatenate(place)


def _slide(
    R: np.ndarray, t: np.ndarray, place: np.ndarray, shape: ShapeModel, slides: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    if slides == 0:
        return R, t, place
    steps = 0.1 * np.arange(-slides, slides + 1)
    long_axis = shape.moment_root[:, np.linalg.norm(shape.moment_root, axis=0).argmax()]
    long_axis = long_axis / np.linalg.norm(long_axis)
    shifted = t[:, None] + steps[None, :, None] * (R @ long_axis)[:, None]
    return np.repeat(R, len(steps), axis=0), shifted.reshape(-1, 3), np.repeat(place, len(steps))
