"""Metrics of the paper (PS6D, sec. IV-C): instance-level F1 and point-wise recall, and precision and accuracy beside.

Definitions, per frame:

- The visibility of an instance is n_i / max n_i, n_i the number of points (pixels) on which it was seen (eq. N_gt).
- N_gt counts the instances with visibility above T_v = 0.4; the others are ignored.
- A predicted pose is paired with the instance of least distance D. Pairs are settled from the nearest up, and an
  instance takes one prediction: a second prediction of the same instance is a false positive.
- D is the mean over the CAD points of the point distance of the two poses, least over the symmetries (eq. D_i, with
  the points masked by v). A pair is a true positive where D < T_e = `workpiece.tolerance`.
- A prediction that is right (D < T_e) about an ignored instance counts neither as true nor as false positive; a
  second prediction of such an instance, and any prediction that is not right, is a false positive.
- Point-wise recall: share of the CAD points, over the N_gt instances, whose own distance in the paired prediction is
  below T_e; an instance without a prediction contributes none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pickproof.cell.frames import Array
from pickproof.cell.symmetry.pose_error import point_distances, rotation_error
from pickproof.cell.workpiece.workpiece import Workpiece

VISIBILITY = 0.4
"""T_v of the paper."""

POINTS = 500
"""CAD points a distance is taken over."""


@dataclass(frozen=True)
class FrameScore:
    """Counts of one frame.

    Attributes:
        n_gt: instances that count; n_pred: predictions that count; true_positives: right ones among them.
        recall_points: CAD points closer than T_e; all_points: n_gt times the number of CAD points.
        distances, angles: (true_positives,) centre distance in [m] and least rotation angle in [rad].
        matched: (predictions,) instance each prediction was right about, -1 for none.
    """

    n_gt: int
    n_pred: int
    true_positives: int
    recall_points: int
    all_points: int
    distances: Array
    angles: Array
    matched: NDArray[np.int64]


@dataclass(frozen=True)
class Summary:
    """Figures over many frames; shares in [0, 1], medians over true positives in [mm] and [deg] (NaN for none)."""

    f1_inst: float
    recall: float
    precision: float
    instance_recall: float
    median_mm: float
    median_deg: float
    frames: int


def visible_instances(pixel_counts: np.ndarray, threshold: float = VISIBILITY) -> np.ndarray:
    """Which instances (n,) count: n_i / max n_i > T_v (eq. N_gt)."""
    counts = np.asarray(pixel_counts, dtype=np.float64)
    most = counts.max(initial=0.0)
    return counts / most > threshold if most > 0 else np.zeros(len(counts), dtype=bool)


def score_frame(
    Ts_pred: Array,
    Ts_true: Array,
    counted: np.ndarray,
    workpiece: Workpiece,
    tolerance: float | None = None,
    points: Array | None = None,
) -> FrameScore:
    """Compare predictions (p, 4, 4) with the instances (n, 4, 4) of a frame, both in the same frame, in [m].

    Args:
        counted: (n,) bool, from `visible_instances`.
        tolerance: T_e in [m]; None for the workpiece's.
        points: CAD points (k, 3) in [m]; None for a fixed sample of the surface.
    """
    points = workpiece.sample_surface(POINTS)[0] if points is None else points
    tolerance = workpiece.tolerance if tolerance is None else tolerance
    Ts_pred = np.asarray(Ts_pred, dtype=np.float64).reshape(-1, 4, 4)
    Ts_true = np.asarray(Ts_true, dtype=np.float64).reshape(-1, 4, 4)
    counted = np.asarray(counted, dtype=bool)
    p, n = len(Ts_pred), len(Ts_true)
    D = np.full((p, n), np.inf)
    for i in range(p if n else 0):
        D[i] = point_distances(Ts_true, Ts_pred[i][None], points, workpiece.symmetry).mean(-1)
    nearest = D.argmin(1) if n else np.full(p, -1)
    least = D[np.arange(p), nearest] if n else np.full(p, np.inf)
    # the nearest prediction of an instance is its match; the rest of them are duplicates
    taken = np.zeros(n, dtype=bool)
    paired = np.full(p, -1, dtype=np.int64)
    for closest in np.argsort(least, kind="stable"):
        instance = nearest[closest]
        if n and not taken[instance]:
            taken[instance] = True
            paired[closest] = instance
    right = (paired >= 0) & (least < tolerance)
    matched = np.where(right, paired, -1)
    ignored = right & ~counted[paired] if n else np.zeros(p, dtype=bool)
    hits = np.flatnonzero(right & ~ignored)
    recalled = 0
    for k in np.flatnonzero(paired >= 0):
        if counted[paired[k]]:
            d = point_distances(Ts_true[paired[k]], Ts_pred[k], points, workpiece.symmetry)
            recalled += int((d < tolerance).sum())
    n_gt = int(counted.sum())
    return FrameScore(
        n_gt=n_gt,
        n_pred=p - int(ignored.sum()),
        true_positives=len(hits),
        recall_points=recalled,
        all_points=n_gt * len(points),
        distances=np.asarray([np.linalg.norm(Ts_pred[i, :3, 3] - Ts_true[paired[i], :3, 3]) for i in hits]),
        angles=np.asarray(
            [rotation_error(Ts_true[paired[i], :3, :3], Ts_pred[i, :3, :3], workpiece.symmetry) for i in hits]
        ),
        matched=matched,
    )


def summarise(frames: Sequence[FrameScore]) -> Summary:
    """Totals over frames (micro average). F1 = 2 TP / (N_pred + N_gt), the paper's equation solved."""
    tp = sum(f.true_positives for f in frames)
    n_pred, n_gt = sum(f.n_pred for f in frames), sum(f.n_gt for f in frames)
    distances = np.concatenate([f.distances for f in frames]) if frames else np.zeros(0)
    angles = np.concatenate([f.angles for f in frames]) if frames else np.zeros(0)
    return Summary(
        f1_inst=_share(2 * tp, n_pred + n_gt),
        recall=_share(sum(f.recall_points for f in frames), sum(f.all_points for f in frames)),
        precision=_share(tp, n_pred),
        instance_recall=_share(tp, n_gt),
        median_mm=float(np.median(distances) * 1e3) if len(distances) else float("nan"),
        median_deg=float(np.rad2deg(np.median(angles))) if len(angles) else float("nan"),
        frames=len(frames),
    )


def _share(part: float, whole: float) -> float:
    """part / whole; 1 where nothing was asked and nothing claimed."""
    return part / whole if whole else 1.0
