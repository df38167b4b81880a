"""Stable poses of a solid on a plane, and their probabilities when it is dropped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from pickproof.cell.frames import Array, apply, make_transform
from pickproof.cell.symmetry.symmetry import Symmetry

LEAST = 0.002
"""Probability below which a facet is left out."""
ALIKE = float(np.cos(np.deg2rad(8.0)))


@dataclass(frozen=True)
class Resting:
    """One resting pose: T_plane_part (4, 4), lowest point at z = 0 over the origin, and its probability."""

    T_plane_part: Array
    probability: float


def resting_poses(mesh: trimesh.Trimesh, symmetry: Symmetry, at_least: float = 0.02) -> list[Resting]:
    """Stable poses of a closed mesh, likeliest first; poses equal by symmetry or by rolling are merged.

    The probabilities are those of a body without inertia that is dropped in any orientation (trimesh's
    `compute_stable_poses`, after Goldberg et al. 1999), scaled to add up to one.
    """
    Ts, chances = mesh.compute_stable_poses(sigma=0.0, n_samples=1, threshold=LEAST)
    order = np.argsort(-np.asarray(chances), kind="stable")
    rotations = symmetry.rotations(72)
    downs: list[Array] = []
    first: list[Array] = []
    total: list[float] = []
    for i in order:
        R = np.asarray(Ts[i])[:3, :3]
        down = -R[2]
        same = next((k for k, images in enumerate(downs) if (images @ down).max() > ALIKE), None)
        if same is not None:
            total[same] += float(chances[i])
            continue
        downs.append(rotations @ down)
        moved = apply(make_transform(R), np.asarray(mesh.vertices))
        low, high = moved.min(axis=0), moved.max(axis=0)
        first.append(make_transform(R, (-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2])))
        total.append(float(chances[i]))
    whole = sum(total) or 1.0
    found = [Resting(T, p / whole) for T, p in zip(first, total, strict=True) if p / whole >= at_least]
    return sorted(found, key=lambda r: -r.probability)
