"""`pickproof evaluate`: the paper's metrics over held-out seeded heaps, before and after refinement."""

from __future__ import annotations

import argparse
import json
import shlex
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array
from pickproof.cell.sensing.sensor_model import SensorConfig, list_presets
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.perception.data.bop_read import BopImage
from pickproof.perception.data.overlay import Pictured, draw_frames
from pickproof.perception.data.scenes import HELD_OUT_SEED
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
from pickproof.perception.pose_estimate import PoseEstimate
from pickproof.perception.ps6d.weights import file_hash, weights_path, weights_record
from pickproof.perception.refinement.score_model import reliability
from pickproof.perception.training.scene_source import add_source_arguments, given_scenes

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


def report_of(frames: list[Frame]) -> dict[str, object]:
    """Figures of each method as evaluation.json holds them; shares in per cent."""
    methods: dict[str, object] = {}
    means: dict[str, float] = {}
    for frame in frames:
        for stage, t in frame.seen.result.seconds.items():
            means[stage] = means.get(stage, 0.0) + t / len(frames)
    raw_stages = {stage: means[stage] for stage in ("network", "cluster") if stage in means}
    fitted = [f.fitted for f in frames if f.fitted is not None]
    for name, scores, seconds in (
        ("ps6d", [f.raw for f in frames], raw_stages),
        ("ps6d_fitted", fitted, raw_stages | {"fit": means.get("fit", 0.0)}),
        ("ps6d_refined", [f.refined for f in frames], {k: v for k, v in means.items() if k != "fit"}),
    ):
        if not scores:
            continue
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `pickproof evaluate`."""
    parser.add_argument("workpiece")
    parser.add_argument("--frames", type=int, default=None, help="heaps (default 50 held-out ones, or all given ones)")
    parser.add_argument("--seed", type=int, default=0, help="added to the first held-out seed")
    add_source_arguments(parser)
    parser.add_argument("--bop-results", type=Path, metavar="FILE", help="write the poses found in --bop as BOP's CSV")
    parser.add_argument("--weights", type=Path, default=None, help="weights to evaluate (default the shipped ones)")
    sensor = parser.add_mutually_exclusive_group()
    sensor.add_argument("--sensor", metavar="PRESET", help="camera class (default structured_light)")
    sensor.add_argument("--no-noise", action="store_true", help="exact depth in place of the sensor model")
    parser.add_argument("--workers", type=int, default=1, help="processes (default 1)")
    parser.add_argument("--json", action="store_true", help="print the evaluation as JSON; progress goes to stderr")
    parser.add_argument("--out", type=Path, default=None, help="output folder (default out/evaluate/WORKPIECE)")


def main_evaluate(args: argparse.Namespace) -> int:
    """`pickproof evaluate WORKPIECE`."""
    for option, value, least, most in (
        ("frames", args.frames, 1, 1_000_000), ("seed", args.seed, 0, 2**31 - 1), ("workers", args.workers, 1, 256)
    ):  # fmt: skip
        if value is not None and not least <= value <= most:
            raise InputError("command line", f"--{option}", value, f"{least} to {most}")
    if args.bop is not None and (args.sensor or args.no_noise):
        option, value = ("--sensor", args.sensor) if args.sensor else ("--no-noise", "given")
        raise InputError("command line", option, value, "none with --bop, whose images were measured")
    if args.bop_results is not None and args.bop is None:
        raise InputError("command line", "--bop-results", str(args.bop_results), "to stand beside --bop DIR")
    if args.sensor is not None and args.sensor not in list_presets():
        raise InputError("command line", "--sensor", args.sensor, f"one of: {', '.join(list_presets())}")
    sensor = SensorConfig.of_preset(args.sensor) if args.sensor else SensorConfig(enabled=not args.no_noise)
    workpiece = load_workpiece(args.workpiece)
    weights = args.weights or weights_path(workpiece)
    setup = Setup(workpiece.name, weights, sensor, HELD_OUT_SEED)
    setup.check()
    given = given_scenes(args, workpiece, args.workers)
    if given is not None and args.seed:
        raise InputError("command line", "--seed", args.seed, "none with --data or --bop, which hold their scenes")
    out = args.out or Path("out") / "evaluate" / workpiece.name
    out.mkdir(parents=True, exist_ok=True)
    console = Console(stderr=args.json)
    first_seed = HELD_OUT_SEED + args.seed if given is None else 0
    if given is None:
        source = perceive_seeds(setup, first_seed, args.frames or FRAMES, args.workers, console, "evaluating")
    else:
        given = given[: args.frames]
        source = perceive_given(setup, given, args.workers, console, "evaluating")
    with source as seen:
        frames = list(score_frames(seen, workpiece, first_seed))
    if args.bop_results is not None:
        images = [scene for scene in given or () if isinstance(scene, BopImage)]
        write_results(args.bop_results, ((i, f.seen.result) for i, f in zip(images, frames, strict=True)))
    instances = Instances.join([f.instances for f in frames])
    data: dict[str, Any] = {
        "workpiece": workpiece.name,
        "command": f"pickproof {shlex.join(args.words)}",
        "weights": file_hash(weights),
        "record": weights_record(weights),
        "noise": sensor.enabled,
        "sensor": sensor.model_dump(),
        "scenes": str(args.bop or args.data or "held-out heaps"),
        "tolerance_mm": 1000 * workpiece.tolerance,
        "methods": report_of(frames),
        "recall_by_visibility": recall_by_visibility(instances),
        "axis_errors": spread(np.concatenate([f.errors for f in frames])),
        "calibration": calibration_of(frames),
    }
    (out / "evaluation.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    instances.save(out / "instances.csv")
    worst = sorted(frames, key=lambda f: _f1(f.refined))[:PICTURED]
    draw_frames([f.pictured for f in worst], workpiece, out / "evaluation.png")
    shown = [(f.seed, f.refined, f.pictured) for f in worst]
    scores = [f.refined for f in frames]
    write_page(Evaluation(workpiece, data, instances, scores, shown), out / "evaluation.html")
    if args.json:
        print(json.dumps(data, indent=1))
    else:
        _print(console, workpiece, data)
        if args.bop_results is not None:
            console.print(f"wrote {args.bop_results}", soft_wrap=True)
        console.print(f"wrote evaluation.html, .json, .png and instances.csv to {out}", soft_wrap=True)
    return 0


def _f1(score: FrameScore) -> float:
    return 2 * score.true_positives / max(score.n_pred + score.n_gt, 1)


def _print(console: Console, workpiece: Workpiece, data: dict[str, Any]) -> None:
    table = Table(title=f"{workpiece.name}: {data['scenes']}, T_e = {data['tolerance_mm']:g} mm")
    columns = ("f1_inst", "recall", "precision", "median_mm", "median_deg")
    for column in ("method", *columns, "s/frame"):
        head = column.replace("median_", "median\n")
        table.add_column(head, justify="left" if column == "method" else "right", no_wrap=column == "method")
    for name, m in data["methods"].items():
        cells = ["-" if m[c] is None else f"{m[c]:.2f}" for c in columns]
        table.add_row(name, *cells, f"{m['seconds_per_frame']['total']:.2f}")
    console.print(table)
    split = data["methods"]["ps6d_refined"]["seconds_per_frame"]
    console.print("seconds a frame: " + ", ".join(f"{k} {v:.3f}" for k, v in split.items()))
    console.print(f"expected calibration error {data['calibration']['ece']:.3f}")
