"""Analysis of failures: each true instance by visibility, each pose against the nearest instance."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pickproof.cell.frames import Array
from pickproof.cell.symmetry.pose_error import point_distances, rotation_error
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.workpiece.workpiece import Workpiece

VISIBILITY_BINS = 10
AXES = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")


@dataclass(frozen=True)
class Instances:
    """True instances, of one frame or of many; all (n,).

    Attributes:
        seed: of the heap; index: of the instance in it.
        visibility: n_i / max n_i of its frame, in [0, 1].
        counted: visibility above T_v; found: a prediction is right about it.
        distance: D of the nearest prediction in [m] (metrics.py); NaN in a frame without predictions.
        translation, rotation: error of that prediction, between the centres in [m] and the least angle in [rad].
    """

    seed: np.ndarray
    index: np.ndarray
    visibility: Array
    counted: np.ndarray
    found: np.ndarray
    distance: Array
    translation: Array
    rotation: Array

    @staticmethod
    def join(parts: Sequence[Instances]) -> Instances:
        """Those of several frames."""
        return Instances(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Instances)})

    def save(self, path: Path) -> None:
        """Write as CSV, a row an instance; lengths in [m], angles in [rad]."""
        names = [f.name for f in fields(self)]
        with path.open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            rows.writerow(names)
            rows.writerows(zip(*(getattr(self, name).tolist() for name in names), strict=True))


def distances(Ts_pred: Array, Ts_true: Array, points: Array, symmetry: Symmetry) -> Array:
    """D (p, n) in [m] of predictions (p, 4, 4) and instances (n, 4, 4), over CAD points (k, 3) (metrics.py)."""
    rows = [point_distances(Ts_true, T[None], points, symmetry).mean(-1) for T in Ts_pred] if len(Ts_true) else []
    return np.array(rows, dtype=np.float64).reshape(len(Ts_pred), len(Ts_true))


def instances_of(
    seed: int,
    visibility: Array,
    counted: np.ndarray,
    matched: np.ndarray,
    D: Array,
    Ts_pred: Array,
    Ts_true: Array,
    symmetry: Symmetry,
) -> Instances:
    """The instances (n,) of one frame; `matched` (p,) from `score_frame`, D (p, n) from `distances`."""
    p, n = D.shape
    distance, translation, rotation = (np.full(n, np.nan) for _ in range(3))
    for j, i in enumerate(D.argmin(0) if p else []):
        distance[j] = D[i, j]
        translation[j] = np.linalg.norm(Ts_pred[i, :3, 3] - Ts_true[j, :3, 3])
        rotation[j] = rotation_error(Ts_true[j, :3, :3], Ts_pred[i, :3, :3], symmetry)
    found = np.isin(np.arange(n), matched)
    return Instances(np.full(n, seed), np.arange(n), visibility, counted, found, distance, translation, rotation)


def recall_by_visibility(instances: Instances, bins: int = VISIBILITY_BINS) -> list[dict[str, float | int | None]]:
    """Instances and found ones by visibility, in classes of equal width; recall in per cent, None in an empty class."""
    which = np.minimum((instances.visibility * bins).astype(int), bins - 1)
    rows: list[dict[str, float | int | None]] = []
    for b in range(bins):
        mine = which == b
        n, found = int(mine.sum()), int(instances.found[mine].sum())
        recall = 100 * found / n if n else None
        rows.append({"low": b / bins, "high": (b + 1) / bins, "count": n, "found": found, "recall": recall})
    return rows


def right_poses(Ts_pred: Array, Ts_true: Array, points: Array, workpiece: Workpiece) -> np.ndarray:
    """Which poses (p, 4, 4) are right, (p,) bool: D < T_e for any of the instances (n, 4, 4), counted or not."""
    # D is at least the distance of the two centroids of the CAD points, so instances farther off need no look
    reach = workpiece.tolerance + 2 * float(np.linalg.norm((points * workpiece.symmetry.v).mean(0)))
    right = np.zeros(len(Ts_pred), dtype=bool)
    for i, T in enumerate(Ts_pred):
        near = Ts_true[np.linalg.norm(Ts_true[:, :3, 3] - T[:3, 3], axis=1) < reach]
        right[i] = bool((distances(T[None], near, points, workpiece.symmetry) < workpiece.tolerance).any())
    return right


def axis_errors(Ts_pred: Array, Ts_true: Array, matched: np.ndarray, workpiece: Workpiece) -> Array:
    """Errors (k, 6) in [mm] and [deg] of the right poses, along and about the axes of the CAD at the centre of mass.

    Of symmetric poses the nearest one counts; a turn about the axis of a body of revolution is no error.

    Args:
        Ts_pred: (p, 4, 4); Ts_true: (n, 4, 4), in the same frame.
        matched: (p,) instance that each pose is right about, -1 for none.
    """
    symmetry, com = workpiece.symmetry, workpiece.com
    errors = []
    for T, j in zip(Ts_pred, matched, strict=True):
        if j < 0:
            continue
        R = Ts_true[j, :3, :3].T @ T[:3, :3]
        S = min(symmetry.S, key=lambda s: float(np.linalg.norm(_turn(s.T @ R, symmetry))))
        shift = S.T @ Ts_true[j, :3, :3].T @ (T[:3, :3] @ com + T[:3, 3] - Ts_true[j, :3, 3]) - com
        errors.append(np.concatenate([1000 * shift, np.rad2deg(_turn(S.T @ R, symmetry))]))
    return np.array(errors).reshape(-1, len(AXES))


def _turn(R: Array, symmetry: Symmetry) -> Array:
    """Rotation vector (3,) in [rad], without what turns about an infinite axis."""
    axis = symmetry.infinite_axis
    if symmetry.is_sphere:
        return np.zeros(3)
    if axis is None:
        return np.asarray(Rotation.from_matrix(R).as_rotvec())
    way = np.cross(np.eye(3)[axis], R[:, axis])
    size = float(np.linalg.norm(way))
    return np.asarray(way * (np.arctan2(size, R[axis, axis]) / max(size, 1e-12)))


def spread(errors: Array) -> dict[str, dict[str, float | None]]:
    """Median and 95 % quantile of the size of errors (k, 6) along each of AXES; None of nothing."""
    sizes = np.quantile(np.abs(errors), (0.5, 0.95), axis=0) if len(errors) else np.full((2, len(AXES)), np.nan)
    known = [[None if np.isnan(v) else float(v) for v in row] for row in sizes.T]
    return {name: {"median": row[0], "p95": row[1]} for name, row in zip(AXES, known, strict=True)}
