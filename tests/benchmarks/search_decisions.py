"""Fits the two decisions of the search, and says what they do on the parts that each fit leaves out.

`python -m tests.benchmarks.search_decisions PART... --heaps 8` looks at validation heaps of each part with the search,
fits the order and the acceptance without each part in turn (leave one part out), and prints F1_inst and the expected
calibration error of the left-out parts, then the weights of a fit to all. Parts whose name begins with fit_ are made by
`tests.benchmarks.generated_parts`.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import minimize
from scipy.special import expit

from pickproof.cell.child_process import FOLDERS, child_environment
from pickproof.cell.frames import Array
from pickproof.cell.sensing.sensor_model import SensorConfig
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.cad.shape_model import ShapeModel
from pickproof.perception.data.scenes import VALIDATION_SEED, heap_bin, load_heaps
from pickproof.perception.evaluation.analysis import right_poses
from pickproof.perception.evaluation.heap_frames import HeapFrame, Setup, perceive_scenes
from pickproof.perception.evaluation.metrics import POINTS, FrameScore, score_frame, summarise, visible_instances
from pickproof.perception.ps6d.cloud import roi_mask
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.refinement.rivalry import rivalry, suppress
from pickproof.perception.refinement.score_model import SIGNS, reliability
from pickproof.perception.search.config import SearchConfig
from pickproof.perception.search.decision import FEATURES, DecisionModel
from tests.benchmarks.generated_parts import PARTS, make_workpiece

RULES = SearchConfig.model_validate({}).verify
OF_VOTES = ("log_votes", "centres_agree", "rotations_agree")
BOUNDS = [(0.0, None) if sign > 0 else (None, 0.0) for sign in (*SIGNS, -1)]
MOST = 400
"""Examples, and pairs of rivals, of one part."""


@dataclass(frozen=True)
class Looked:
    """One frame: what was seen and, of h examined poses, features (h, d), truth (h,), conflicts (h, h), plausible."""

    seen: HeapFrame
    features: Array
    right: np.ndarray
    shared: Array
    overlap: Array
    plausible: np.ndarray


def look(name: str, heaps: int, folder: Path) -> list[Looked]:
    """Every pose that the search examines in validation heaps of a part."""
    workpiece = load_workpiece(name)
    shape, points = ShapeModel.of(workpiece), workpiece.sample_surface(POINTS)[0]
    poses = load_heaps(workpiece, VALIDATION_SEED, heaps, folder / "heaps", 1)
    found = []
    for seen in perceive_scenes(Setup(name, None, SensorConfig(), VALIDATION_SEED, method="search"), poses):
        if (examined := seen.result.examined) is None:
            continue
        roi = roi_mask(seen.frame, heap_bin(workpiece))
        surface = SurfaceMap.of(seen.frame, shape.unit, shape.deviation(seen.frame.sigma), roi)
        T, x = examined.Ts_camera_part, examined.features
        R, t = (torch.from_numpy(a.astype(np.float32)) for a in (T[:, :3, :3], T[:, :3, 3] / shape.unit))
        against = sum(x[:, k] / np.maximum(1 - x[:, k], 1e-6) for k in (0, 1))  # violations, wrong normals to inliers
        plausible = (1 / (1 + against) >= RULES.min_ratio) & (np.exp(x[:, 2]) >= RULES.min_visible)
        right = right_poses(T, seen.Ts_camera_part, points, workpiece)
        found.append(Looked(seen, x, right, *rivalry(R, t, surface, shape, RULES), plausible))
    return found


def pairs(frame: Looked) -> Array:
    """Features of a right pose less those of a wrong one that cannot stand beside it, (n, d)."""
    shared, overlap = (np.maximum(a, a.T) for a in (frame.shared, frame.overlap))
    rivals = (shared > RULES.max_shared) | (overlap > RULES.max_overlap)
    i, j = np.nonzero(rivals & frame.right[:, None] & ~frame.right[None])
    return np.asarray(frame.features[i] - frame.features[j])


def fit(X: Array, right: np.ndarray, difference: Array, without: tuple[str, ...] = ()) -> DecisionModel:
    """Penalised likelihood of the truth of poses and of the order of pairs, under the sign that each feature has."""
    mean, spread = X.mean(0), np.maximum(X.std(0), 1e-6)
    Z, Q = np.column_stack([(X - mean) / spread, np.ones(len(X))]), difference / spread
    ridge = np.append(np.ones(X.shape[1]), 1e-6)

    def loss(w: Array) -> tuple[float, Array]:
        z, q = Z @ w, Q @ w[:-1]
        slope = Z.T @ (expit(z) - right) + ridge * w
        slope[:-1] -= Q.T @ expit(-q)
        value = (np.logaddexp(0, z) - right * z).sum() + np.logaddexp(0, -q).sum() + 0.5 * ridge @ w**2
        return float(value), slope

    bounds = [(0.0, 0.0) if name in without else b for name, b in zip(FEATURES, BOUNDS, strict=True)]
    w = minimize(loss, np.zeros(Z.shape[1]), jac=True, method="L-BFGS-B", bounds=[*bounds, (None, None)]).x
    weights = w[:-1] / spread
    return DecisionModel(tuple(float(x) for x in weights), float(w[-1] - mean @ weights))


def fit_both(parts: list[list[Looked]]) -> tuple[DecisionModel, DecisionModel]:
    """The order from all poses and pairs of rivals; the acceptance from the plausible ones that it leaves standing."""
    rng = np.random.default_rng(0)

    def some(x: Array) -> np.ndarray:
        return np.sort(rng.permutation(len(x))[:MOST])

    X, right, difference = [], [], []
    for frames in parts:
        x, y = np.concatenate([f.features for f in frames]), np.concatenate([f.right for f in frames])
        d = np.concatenate([pairs(f) for f in frames])
        i = some(x)
        X.append(x[i]), right.append(y[i]), difference.append(d[some(d)])
    order = fit(np.concatenate(X), np.concatenate(right), np.concatenate(difference), OF_VOTES)
    stand = [(f, standing(f, order)) for frames in parts for f in frames]
    features = np.concatenate([f.features[s] for f, s in stand])
    return order, fit(features, np.concatenate([f.right[s] for f, s in stand]), np.zeros((0, len(FEATURES))))


def standing(frame: Looked, order: DecisionModel) -> np.ndarray:
    """Indices of the plausible poses without a better rival."""
    best = np.argsort(-order.log_odds(frame.features), kind="stable")
    kept = np.array(suppress(best, frame.shared, frame.overlap, RULES), dtype=np.int64)
    return kept[frame.plausible[kept]]


def main() -> None:
    """Print a line for each part, the calibration, and the weights."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="+")
    parser.add_argument("--heaps", type=int, default=8)
    parser.add_argument("--folder", type=Path, default=Path("out") / "generated_parts")
    args = parser.parse_args()
    with child_environment({FOLDERS: str(args.folder.resolve())}):
        for name in set(args.parts) & PARTS.keys():
            make_workpiece(name, args.folder)
        looked = {name: look(name, args.heaps, args.folder) for name in args.parts}
        scores, truth = [], []
        for name, frames in looked.items():
            order, acceptance = fit_both([other for n, other in looked.items() if n != name])
            counts: list[FrameScore] = []
            for f in frames:
                s = standing(f, order)
                p = acceptance.score(f.features[s])
                scores.append(p), truth.append(f.right[s])
                assert f.seen.result.examined is not None
                believed = f.seen.result.examined.Ts_camera_part[s[p >= 0.5]]
                counted = visible_instances(f.seen.pixels)
                counts.append(score_frame(believed, f.seen.Ts_camera_part, counted, load_workpiece(name)))
            m = summarise(counts)
            print(f"{name}: F1 {100 * m.f1_inst:.1f}, precision {100 * m.precision:.1f}, left out of the fit")
    print(f"expected calibration error {reliability(np.concatenate(scores), np.concatenate(truth))['ece']:.3f}")
    for title, model in zip(("order", "acceptance"), fit_both(list(looked.values())), strict=True):
        weights = {n: round(w, 3) for n, w in zip(FEATURES, model.weights, strict=True) if abs(w) > 1e-9}
        print(title, round(model.bias, 3), weights)


if __name__ == "__main__":
    main()
