"""Differences of poses of a workpiece, minimised over its symmetries."""

from __future__ import annotations

import numpy as np

from pickproof.cell.frames import Array, rotation_angle
from pickproof.cell.symmetry.symmetry import Symmetry


def point_distances(Ts_true: Array, Ts_pred: Array, points: Array, symmetry: Symmetry) -> Array:
    """Distances (..., n) in [m] of CAD points (n, 3) between poses (..., 4, 4), at the best symmetry (eq. D_i).

    For a body of revolution the points are projected on the axis with v, so a rotation about it counts as no
    difference.
    """
    masked = points * symmetry.v
    Rp, tp = Ts_pred[..., :3, :3], Ts_pred[..., :3, 3]
    Rt, tt = Ts_true[..., :3, :3], Ts_true[..., :3, 3]
    predicted = masked @ np.swapaxes(Rp, -1, -2) + tp[..., None, :]
    best: Array | None = None
    for s in symmetry.S:
        true = masked @ np.swapaxes(Rt @ s, -1, -2) + tt[..., None, :]
        d = np.linalg.norm(true - predicted, axis=-1)
        best = d if best is None else np.where((d.mean(-1) < best.mean(-1))[..., None], d, best)
    assert best is not None  # the group has at least the identity
    return best


def rotation_error(R_true: Array, R_pred: Array, symmetry: Symmetry) -> float:
    """Least angle in [rad] between two rotations over the symmetries; of the axes for a body of revolution."""
    if symmetry.is_sphere:
        return 0.0
    axis = symmetry.infinite_axis
    if axis is not None:
        cosines = [float((R_true @ s)[:, axis] @ R_pred[:, axis]) for s in symmetry.S]
        return float(np.arccos(np.clip(max(cosines), -1.0, 1.0)))
    return float(min(rotation_angle(R_pred.T @ R_true @ s) for s in symmetry.S))
