"""Average precision over the score: as Bregier et al. define it for parts in bulk, and as BOP does on MSSD.

The definitions, and where ours cannot follow them, stand in docs/reference/perception-metrics.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from trimesh.nsphere import minimum_nsphere

from pickproof.cell.frames import Array, apply
from pickproof.cell.sensing.camera import Intrinsics, Render, render
from pickproof.cell.workpiece.workpiece import Workpiece

SILEANE_DISTANCE = 0.1
"""Of the diameter: greatest distance of a true positive (Bregier et al. 2017)."""

SILEANE_VISIBLE = 0.5
"""Instances seen at least to this share are to be retrieved (occlusion at most 50 %)."""

BOP_THRESHOLDS = tuple(0.001 * mm for mm in range(2, 21, 2))
"""[m] thresholds of MSSD for 6D detection on BOP-Industrial (BOP 2025: 2, 4, .. 20 mm)."""

BOP_VISIBLE = 0.1
"""Instances seen to less than this share are ignored (BOP)."""

BOP_ESTIMATES = 100
"""Estimates of the best scores that BOP takes an image."""

BOP_SYMMETRY_STEPS = int(np.ceil(np.pi / 0.01))
"""Rotations that stand for an infinite symmetry: the farthest point moves at most 1 % of the diameter a step (BOP)."""


@dataclass(frozen=True)
class Detections:
    """Predictions and truth of one frame, both in the same frame of reference, in [m].

    Attributes:
        Ts_pred: (p, 4, 4) predicted poses of the CAD frame.
        scores: (p,) their scores; only the order counts.
        Ts_true: (n, 4, 4) poses of all instances.
        visible: (n,) visible share of each instance in [0, 1], from `visible_share`.
    """

    Ts_pred: Array
    scores: Array
    Ts_true: Array
    visible: Array


def unoccluded_pixels(workpiece: Workpiece, Ts_camera_part: Array, intrinsics: Intrinsics) -> NDArray[np.int64]:
    """Pixels (n,) that each instance (n, 4, 4) would fill alone; pixels beyond the image's border count, as in BOP."""
    return np.array([_pixels_alone(workpiece, T, intrinsics) for T in Ts_camera_part], dtype=np.int64)


def _pixels_alone(workpiece: Workpiece, T_camera_part: Array, intrinsics: Intrinsics) -> int:
    uv = intrinsics.project(apply(T_camera_part, workpiece.vertices))
    low = np.floor(uv.min(axis=0)).astype(int)
    width, height = (np.ceil(uv.max(axis=0)).astype(int) - low + 1).tolist()
    cx, cy = intrinsics.cx - low[0], intrinsics.cy - low[1]
    crop = Intrinsics(width, height, intrinsics.fx, intrinsics.fy, float(cx), float(cy))
    alone = render(workpiece.vertices, workpiece.faces, T_camera_part[None], (), crop, np.eye(4))
    return int((alone.ids == 0).sum())


def visible_share(exact: Render, workpiece: Workpiece, Ts_camera_part: Array, intrinsics: Intrinsics) -> Array:
    """Share (n,) of its unoccluded pixels on which each instance (n, 4, 4) of an exact render is seen."""
    seen = np.bincount(exact.ids[exact.ids >= 0], minlength=len(Ts_camera_part))
    return seen / np.maximum(unoccluded_pixels(workpiece, Ts_camera_part, intrinsics), 1)


def representatives(Ts: Array, workpiece: Workpiece) -> Array:
    """Points (n, k, d) in [m] that stand for poses (n, 4, 4): the distance of two poses is the least between theirs.

    It is the root mean square distance of the surface at the best symmetry (Bregier et al. 2018): d = 12, and
    k the order of the group; with an axis of revolution d = 6, and k = 1, or 2 where the axis can be reversed; for a
    sphere d = 3.
    """
    Ts = np.asarray(Ts, dtype=np.float64).reshape(-1, 4, 4)
    centre, covariance = _surface_moments(workpiece)
    symmetry, n = workpiece.symmetry, len(Ts)
    R, t = Ts[:, :3, :3], apply(Ts, centre[None])[:, 0]
    if symmetry.is_sphere:
        return t[:, None]
    axis = symmetry.infinite_axis
    if axis is None:
        root = _matrix_root(covariance)
        turned = np.einsum("nij,kjl,lm->nkim", R, symmetry.S, root).reshape(n, len(symmetry.S), 9)
    else:
        # lambda^2 = lambda_r^2 + lambda_z^2, the radial variance taken as the mean of both directions
        scale = np.sqrt(covariance[axis, axis] + (np.trace(covariance) - covariance[axis, axis]) / 2)
        signs = np.unique(np.rint(symmetry.S[:, axis, axis]))
        turned = scale * signs[None, :, None] * R[:, None, :, axis]
    return np.concatenate([turned, np.broadcast_to(t[:, None], (n, turned.shape[1], 3))], axis=-1)


def pose_distances(Ts_a: Array, Ts_b: Array, workpiece: Workpiece) -> Array:
    """Distances (a, b) in [m] of poses (a, 4, 4) and (b, 4, 4) by `representatives`."""
    a, b = representatives(Ts_a, workpiece)[:, 0], representatives(Ts_b, workpiece)
    return np.linalg.norm(a[:, None, None] - b[None], axis=-1).min(axis=-1)


def _surface_moments(workpiece: Workpiece) -> tuple[Array, Array]:
    """Centroid (3,) of the surface, on the axes of symmetry, and its covariance (3, 3), integrated over the faces."""
    corners = workpiece.vertices[workpiece.faces]
    weights = workpiece.mesh.area_faces / workpiece.mesh.area_faces.sum()
    centre = weights @ corners.mean(axis=1)
    corners = corners - centre
    total = corners.sum(axis=1)
    moments = np.einsum("fvi,fvj->fij", corners, corners) + total[:, :, None] * total[:, None, :]
    return centre, np.einsum("f,fij->ij", weights, moments) / 12


def _matrix_root(A: Array) -> Array:
    values, axes = np.linalg.eigh(A)
    return (axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T


def diameter(workpiece: Workpiece) -> float:
    """Diameter in [m] of the smallest sphere around the workpiece."""
    return 2.0 * float(minimum_nsphere(workpiece.mesh)[1])


def ap_sileane(frames: Sequence[Detections], workpiece: Workpiece) -> float:
    """Average precision in [0, 1] of Bregier et al. 2017: the area under the mean precision over the mean recall.

    At every score taken as threshold, precision and recall are those of each frame alone, then their mean over frames.

    Raises:
        ValueError: no frames.
    """
    if not frames:
        raise ValueError("no frames to average over")
    limit = SILEANE_DISTANCE * diameter(workpiece)
    distances = [pose_distances(f.Ts_pred, f.Ts_true, workpiece) for f in frames]
    thresholds = np.unique(np.concatenate([f.scores for f in frames]))[::-1]
    curve = np.array(
        [
            np.mean([_sileane_point(f, d, score, limit) for f, d in zip(frames, distances, strict=True)], axis=0)
            for score in (np.inf, *thresholds)
        ]
    )
    precision, recall = curve[:, 0], curve[:, 1]
    return float(precision @ np.diff(recall, prepend=0.0))


def _sileane_point(frame: Detections, distances: Array, score: float, limit: float) -> tuple[float, float]:
    """Precision and recall of a frame's predictions of at least `score`; 1 where nothing is claimed or asked."""
    D = distances[np.asarray(frame.scores) >= score]
    wanted = np.asarray(frame.visible) >= SILEANE_VISIBLE
    hits = ignored = 0
    if D.size:
        nearest = D.argmin(axis=1)
        # right: close to its nearest instance, and no other prediction is closer to that instance
        right = (D.min(axis=1) <= limit) & (D.argmin(axis=0)[nearest] == np.arange(len(D)))
        hits = int((right & wanted[nearest]).sum())
        ignored = int((right & ~wanted[nearest]).sum())
    claimed, asked = len(D) - ignored, int(wanted.sum())
    return hits / claimed if claimed else 1.0, hits / asked if asked else 1.0


def mssd(T_pred: Array, Ts_true: Array, workpiece: Workpiece) -> Array:
    """Maximum symmetry-aware surface distance (n,) in [m] of a pose (4, 4) to poses (n, 4, 4).

    Hodan et al. 2020, sec. 2.2. The greatest distance lies at a vertex of the convex hull. For spheres, which BOP does
    not know, it is the distance of the centres.
    """
    if workpiece.symmetry.is_sphere:
        return np.linalg.norm(T_pred[:3, 3] - Ts_true[:, :3, 3], axis=-1)
    hull = np.asarray(workpiece.mesh.convex_hull.vertices)
    turned = hull @ np.swapaxes(workpiece.symmetry.rotations(BOP_SYMMETRY_STEPS), -1, -2)
    gaps = apply(Ts_true[:, None], turned) - apply(T_pred, hull)
    return np.linalg.norm(gaps, axis=-1).max(axis=-1).min(axis=-1)


def ap_mssd(frames: Sequence[Detections], workpiece: Workpiece) -> float:
    """Average precision in [0, 1] on MSSD, mean over `BOP_THRESHOLDS`, as BOP 2025 scores 6D detection (industrial).

    Raises:
        ValueError: no instance is visible enough to be counted.
    """
    asked = sum(int((np.asarray(f.visible) >= BOP_VISIBLE).sum()) for f in frames)
    if not asked:
        raise ValueError("no instance is visible enough to be counted")
    errors = [_mssd_errors(f, workpiece) for f in frames]
    return float(np.mean([_bop_ap(errors, asked, threshold) for threshold in BOP_THRESHOLDS]))


@dataclass(frozen=True)
class _Errors:
    """A frame's best estimates from the best score down: scores (p,), MSSD (p, n) in [m], counted instances (n,)."""

    scores: Array
    mssd: Array
    counted: NDArray[np.bool_]


def _mssd_errors(frame: Detections, workpiece: Workpiece) -> _Errors:
    order = np.argsort(-np.asarray(frame.scores), kind="stable")[:BOP_ESTIMATES]
    counted = np.asarray(frame.visible) >= BOP_VISIBLE
    errors = np.full((len(order), len(counted)), np.inf)
    # the vertices' mean c moves at least |dt| - 2 |c|: pairs further apart cannot be right
    reach = max(BOP_THRESHOLDS) + 2 * float(np.linalg.norm(workpiece.mesh.convex_hull.vertices.mean(axis=0)))
    for row, i in enumerate(order):
        near = np.linalg.norm(frame.Ts_true[:, :3, 3] - frame.Ts_pred[i, :3, 3], axis=-1) < reach
        if near.any():
            errors[row, near] = mssd(frame.Ts_pred[i], frame.Ts_true[near], workpiece)
    return _Errors(np.asarray(frame.scores, dtype=np.float64)[order], errors, counted)


def _bop_ap(frames: Sequence[_Errors], asked: int, threshold: float) -> float:
    """Precision at 101 levels of recall, interpolated from the right, over all frames' estimates in one ranking."""
    matches = [_match(f.mssd, threshold) for f in frames]
    kept = [(m < 0) | f.counted[m] if len(f.counted) else m < 0 for f, m in zip(frames, matches, strict=True)]
    scores = np.concatenate([f.scores[k] for f, k in zip(frames, kept, strict=True)])
    right = np.concatenate([m[k] >= 0 for m, k in zip(matches, kept, strict=True)])
    right = right[np.argsort(-scores, kind="stable")]
    hits = np.cumsum(right)
    precision = np.maximum.accumulate((hits / np.arange(1, len(hits) + 1))[::-1])[::-1]
    at = np.searchsorted(hits / asked, np.linspace(0.0, 1.0, 101))
    return float(np.append(precision, 0.0)[at].mean())


def _match(errors: Array, threshold: float) -> NDArray[np.int64]:
    """Instance (p,) of each row, -1 for none: row by row the best one below the threshold that is still free."""
    free = errors.copy()
    matches = np.full(len(errors), -1, dtype=np.int64)
    for row in range(len(errors) if errors.size else 0):
        best = int(free[row].argmin())
        if free[row, best] < threshold:
            matches[row] = best
            free[:, best] = np.inf
    return matches
