"""The paper's metrics over held-out seeded heaps, before and after refinement."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array
from pickproof.cell.sensing.sensor_model import SensorConfig
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.perception.data.bop_read import BopImage
from pickproof.perception.data.overlay import Pictured, draw_frames
from pickproof.perception.data.scenes import HELD_OUT_SEED
from pickproof.perception.estimate import method_for
from pickproof.perception.evaluation.analysis import (
    Instances,
    axis_errors,
    distances,
    instances_of,
    recall_by_visibility,
    right_poses,
    spread,
)
from pickproof.perception.evaluation.bop_results import write_results
from pickproof.perception.evaluation.heap_frames import HeapFrame, Setup, perceive_given, perceive_seeds
from pickproof.perception.evaluation.metrics import POINTS, FrameScore, score_frame, summarise, visible_instances
from pickproof.perception.evaluation.page import Evaluation, write_page
from pickproof.perception.method import Method
from pickproof.perception.pose_estimate import PoseEstimate
from pickproof.perception.ps6d.weights import file_hash, weights_path, weights_record
from pickproof.perception.refinement.score_model import reliability
from pickproof.perception.training.scene_source import SceneSource

FRAMES = 50
PICTURED = 6
"""Frames shown in the picture: the worst ones first."""


@dataclass(frozen=True)
class Frame:
    """One evaluated frame.

    Attributes:
        seed: of the heap.
        seen: what was measured, what is true, what was found.
        raw, fitted, refined: scores of the paper's poses, of those by all votes and of the verified ones.
        instances: each true instance and the verified pose nearest to it.
        pictured: what the overlay draws.
        standing_right: (s,) bool, which of the poses without a better rival are right.
        errors: (k, 6) of the right verified poses, `axis_errors`.
    """

    seed: int
    seen: HeapFrame
    raw: FrameScore
    fitted: FrameScore | None
    refined: FrameScore
    instances: Instances
    pictured: Pictured
    standing_right: np.ndarray
    errors: Array


def score_frames(seen: Iterable[HeapFrame], workpiece: Workpiece, first_seed: int) -> Iterator[Frame]:
    """Score what was found in each heap against the truth."""
    points, symmetry = workpiece.sample_surface(POINTS)[0], workpiece.symmetry
    for i, heap in enumerate(seen):
        truth, found = heap.Ts_camera_part, heap.Ts_estimated
        counted = visible_instances(heap.pixels)
        fitted = None if heap.result.fitted is None else _poses(heap.result.fitted)
        raw, fitted_score, refined = (
            None if poses is None else score_frame(poses, truth, counted, workpiece, points=points)
            for poses in (_poses(heap.result.raw), fitted, found)
        )
        assert raw is not None
        assert refined is not None
        D = distances(found, truth, points, symmetry)
        instances = instances_of(first_seed + i, heap.visibility, counted, refined.matched, D, found, truth, symmetry)
        errors = D.min(1, initial=np.inf)
        pictured = Pictured(heap.frame, truth, counted, found, refined.matched, errors)
        examined = heap.result.examined
        standing = np.zeros((0, 4, 4)) if examined is None else examined.Ts_camera_part[examined.standing]
        right = right_poses(standing, truth, points, workpiece)
        by_axis = axis_errors(found, truth, refined.matched, workpiece)
        yield Frame(first_seed + i, heap, raw, fitted_score, refined, instances, pictured, right, by_axis)


def _poses(estimates: list[PoseEstimate]) -> Array:
    return np.array([e.T_camera_part for e in estimates]).reshape(-1, 4, 4)


def report_of(frames: list[Frame], method: Method = "ps6d") -> dict[str, object]:
    """Figures as evaluation.json holds them, of ps6d before and after refinement; shares in per cent."""
    methods: dict[str, object] = {}
    means: dict[str, float] = {}
    for frame in frames:
        for stage, t in frame.seen.result.seconds.items():
            means[stage] = means.get(stage, 0.0) + t / len(frames)
    raw_stages: dict[str, float] = {stage: means[stage] for stage in ("network", "cluster") if stage in means}
    fitted = [f.fitted for f in frames if f.fitted is not None]
    refined, without_fit = [f.refined for f in frames], {k: v for k, v in means.items() if k != "fit"}
    rows = [(str(method), refined, without_fit)]
    if method == "ps6d":
        rows = [("ps6d", [f.raw for f in frames], raw_stages), ("ps6d_refined", refined, without_fit)]
        if fitted:
            rows.insert(1, ("ps6d_fitted", fitted, raw_stages | {"fit": means.get("fit", 0.0)}))
    for name, scores, seconds in rows:
        s = summarise(scores)
        methods[name] = {
            "f1_inst": 100 * s.f1_inst,
            "recall": 100 * s.recall,
            "precision": 100 * s.precision,
            "median_mm": _number(s.median_mm),
            "median_deg": _number(s.median_deg),
            "frames": s.frames,
            "missed": sum(f.n_gt - f.true_positives for f in scores),
            "wrong": sum(f.n_pred - f.true_positives for f in scores),
            "seconds_per_frame": seconds | {"total": sum(seconds.values())},
        }
    return methods


def calibration_of(frames: list[Frame]) -> dict[str, object]:
    """Reliability of the scores of verified poses, and under `standing` of all that have no better rival."""
    scores = np.concatenate([[e.score for e in f.seen.result.estimates] for f in frames])
    right = np.concatenate([f.refined.matched >= 0 for f in frames])
    before = [e.scores[e.standing] for f in frames if (e := f.seen.result.examined) is not None]
    standing = reliability(np.concatenate([np.zeros(0), *before]), np.concatenate([f.standing_right for f in frames]))
    return reliability(scores, right) | {"standing": standing}


def _number(x: float) -> float | None:
    """NaN, the median of nothing, is not JSON."""
    return None if np.isnan(x) else x


@dataclass(frozen=True)
class EvaluationRequest:
    """What is evaluated.

    Attributes:
        workpiece: its name.
        frames: heaps; None for FRAMES held-out ones, or all that are given.
        seed: added to the first held-out seed.
        source: scenes of the user's own.
        bop_results: CSV of the poses found in a BOP dataset, where it is wanted.
        weights: None for the shipped ones; method: how poses are found.
        out: folder that evaluation.json, .html, .png and instances.csv are written to; None for the usual one.
        command: the command line, for the record.
    """

    workpiece: str
    frames: int | None = None
    seed: int = 0
    source: SceneSource = field(default_factory=SceneSource)
    bop_results: Path | None = None
    weights: Path | None = None
    sensor: SensorConfig = field(default_factory=SensorConfig)
    workers: int = 1
    out: Path | None = None
    command: str = ""
    method: Method = "auto"


def evaluate(asked: EvaluationRequest, console: Console) -> tuple[Evaluation, Path]:
    """Measure, and write the files; returns the evaluation and their folder.

    Args:
        console: shows the progress.

    Raises:
        InputError: no such workpiece, weights or scenes.
    """
    workpiece = load_workpiece(asked.workpiece)
    method = method_for(workpiece, asked.method, asked.weights)
    weights = None if method == "search" else asked.weights or weights_path(workpiece)
    setup = Setup(workpiece.name, weights, asked.sensor, HELD_OUT_SEED, method=method)
    setup.check()
    given = asked.source.scenes(workpiece, asked.workers)
    if given is not None and asked.seed:
        raise InputError("command line", "--seed", asked.seed, "none with --data or --bop, which hold their scenes")
    out = asked.out or Path("out") / "evaluate" / workpiece.name
    out.mkdir(parents=True, exist_ok=True)
    first_seed = HELD_OUT_SEED + asked.seed if given is None else 0
    if given is None:
        seeds = perceive_seeds(setup, first_seed, asked.frames or FRAMES, asked.workers, console, "evaluating")
    else:
        given = given[: asked.frames]
        seeds = perceive_given(setup, given, asked.workers, console, "evaluating")
    with seeds as seen:
        frames = list(score_frames(seen, workpiece, first_seed))
    if asked.bop_results is not None:
        images = [scene for scene in given or () if isinstance(scene, BopImage)]
        write_results(asked.bop_results, ((i, f.seen.result) for i, f in zip(images, frames, strict=True)))
    worst = sorted(frames, key=lambda f: _f1(f.refined))[:PICTURED]
    found = Evaluation(
        workpiece,
        document_of(asked, setup, workpiece, frames),
        Instances.join([f.instances for f in frames]),
        [f.refined for f in frames],
        [(f.seed, f.refined, f.pictured) for f in worst],
    )
    (out / "evaluation.json").write_text(json.dumps(found.data, indent=1) + "\n", encoding="utf-8")
    found.instances.save(out / "instances.csv")
    draw_frames([f.pictured for f in worst], workpiece, out / "evaluation.png")
    write_page(found, out / "evaluation.html")
    return found, out


def document_of(asked: EvaluationRequest, setup: Setup, workpiece: Workpiece, frames: list[Frame]) -> dict[str, Any]:
    """What evaluation.json holds; `shown` is the method that figures beside the table are of."""
    weights = setup.weights
    instances = Instances.join([f.instances for f in frames])
    return {
        "workpiece": workpiece.name,
        "command": asked.command,
        "weights": None if weights is None else file_hash(weights),
        "record": {} if weights is None else weights_record(weights),
        "noise": asked.sensor.enabled,
        "sensor": asked.sensor.model_dump(),
        "scenes": str(asked.source.bop or asked.source.data or "held-out heaps"),
        "tolerance_mm": 1000 * workpiece.tolerance,
        "methods": report_of(frames, setup.method),
        "shown": "ps6d_refined" if setup.method == "ps6d" else setup.method,
        "recall_by_visibility": recall_by_visibility(instances),
        "axis_errors": spread(np.concatenate([f.errors for f in frames])),
        "calibration": calibration_of(frames),
    }


def _f1(score: FrameScore) -> float:
    return 2 * score.true_positives / max(score.n_pred + score.n_gt, 1)
