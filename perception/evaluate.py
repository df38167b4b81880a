"""`pickproof evaluate`: the paper's metrics over held-out seeded heaps, before and after refinement."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from cell.camera import DepthFrame
from cell.errors import InputError
from cell.frames import Array, invert
from cell.sensor import SensorConfig, measure
from cell.workpiece import Workpiece, load_workpiece
from perception.calibration import reliability
from perception.estimate import Perception
from perception.metrics import FrameScore, score_frame, summarise, visible_instances
from perception.overlay import Pictured, draw_frames
from perception.pose_estimate import PoseEstimate
from perception.refine import RefineResult
from perception.scenes import HELD_OUT_SEED, heap_bin, load_heaps, overhead_view, render_heap
from perception.weights import file_hash, weights_path, weights_record

HEAPS_FOLDER = Path("out") / "heaps"
PICTURED = 6
"""Frames shown in the picture: the worst ones first."""


@dataclass(frozen=True)
class Frame:
    """One evaluated frame: what was measured, what is true, what was found, and both scores."""

    frame: DepthFrame
    Ts_camera_part: Array
    counted: np.ndarray
    result: RefineResult
    raw: FrameScore
    refined: FrameScore

    @property
    def pictured(self) -> Pictured:
        """What the overlay draws."""
        return self.frame, self.Ts_camera_part, self.counted, self.result.estimates, self.refined.matched


def evaluate_frames(perception: Perception, heaps: list[Array], sensor: SensorConfig) -> Iterator[Frame]:
    """Render each heap from the cell's viewpoint, perceive it, and score it against the truth."""
    workpiece, bin = perception.workpiece, heap_bin(perception.workpiece)
    view = overhead_view(workpiece, sensor)
    points = workpiece.sample_surface(500)[0]
    for i, poses in enumerate(heaps):
        exact = render_heap(workpiece, poses, view)
        rng = np.random.default_rng((HELD_OUT_SEED, i))
        frame = measure(exact, view.intrinsics, view.T_world_camera, sensor, rng)
        result = perception.perceive(frame, bin, rng)
        truth = invert(view.T_world_camera) @ poses
        counted = visible_instances(np.bincount(exact.ids[exact.ids >= 0], minlength=len(poses)))
        raw, refined = (
            score_frame(_poses(found), truth, counted, workpiece, points=points)
            for found in (result.raw, result.estimates)
        )
        yield Frame(frame, truth, counted, result, raw, refined)


def _poses(estimates: list[PoseEstimate]) -> Array:
    return np.stack([e.T_camera_part for e in estimates]) if estimates else np.zeros((0, 4, 4))


def report_of(frames: list[Frame]) -> dict[str, object]:
    """Figures of both methods as evaluation.json holds them; shares in per cent."""
    methods: dict[str, object] = {}
    means: dict[str, float] = {}
    for frame in frames:
        for stage, t in frame.result.seconds.items():
            means[stage] = means.get(stage, 0.0) + t / len(frames)
    raw_stages = {stage: means[stage] for stage in ("network", "cluster") if stage in means}
    for name, scores, seconds in (
        ("ps6d", [f.raw for f in frames], raw_stages),
        ("ps6d_refined", [f.refined for f in frames], means),
    ):
        s = summarise(scores)
        methods[name] = {
            "f1_inst": 100 * s.f1_inst,
            "recall": 100 * s.recall,
            "precision": 100 * s.precision,
            "median_mm": _number(s.median_mm),
            "median_deg": _number(s.median_deg),
            "frames": s.frames,
            "seconds_per_frame": seconds | {"total": sum(seconds.values())},
        }
    return methods


def _number(x: float) -> float | None:
    """NaN, the median of nothing, is not JSON."""
    return None if np.isnan(x) else x


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `pickproof evaluate`."""
    parser.add_argument("workpiece")
    parser.add_argument("--frames", type=int, default=50, help="held-out heaps (default 50)")
    parser.add_argument("--seed", type=int, default=0, help="added to the first held-out seed")
    parser.add_argument("--weights", type=Path, default=None, help="weights to evaluate (default the shipped ones)")
    parser.add_argument("--no-noise", action="store_true", help="exact depth in place of the sensor model")
    parser.add_argument("--out", type=Path, default=None, help="output folder (default out/evaluate/WORKPIECE)")


def main_evaluate(args: argparse.Namespace) -> int:
    """`pickproof evaluate WORKPIECE`."""
    if args.frames < 1:
        raise InputError("command line", "--frames", args.frames, "1 or more")
    if args.seed < 0:
        raise InputError("command line", "--seed", args.seed, "0 or more")
    workpiece = load_workpiece(args.workpiece)
    weights = args.weights or weights_path(workpiece)
    perception = Perception.load(workpiece, weights)
    out = args.out or Path("out") / "evaluate" / workpiece.name
    out.mkdir(parents=True, exist_ok=True)
    console = Console()
    sensor = SensorConfig(enabled=not args.no_noise)
    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()]
    frames: list[Frame] = []
    with Progress(*columns, console=console) as bar:
        settling = bar.add_task("settling heaps", total=args.frames)
        first = HELD_OUT_SEED + args.seed
        heaps = load_heaps(workpiece, first, args.frames, HEAPS_FOLDER, 1, lambda n: bar.update(settling, completed=n))
        task = bar.add_task("evaluating", total=args.frames)
        for frame in evaluate_frames(perception, heaps, sensor):
            frames.append(frame)
            bar.advance(task)
    methods = report_of(frames)
    scores = np.concatenate([[e.score for e in f.result.estimates] for f in frames])
    right = np.concatenate([f.refined.matched >= 0 for f in frames])
    data = {
        "workpiece": workpiece.name,
        "weights": file_hash(weights),
        "record": weights_record(weights),
        "noise": not args.no_noise,
        "tolerance_mm": 1000 * workpiece.tolerance,
        "methods": methods,
        "calibration": reliability(scores, right),
    }
    (out / "evaluation.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    worst = sorted(range(len(frames)), key=lambda i: _f1(frames[i].refined))[:PICTURED]
    draw_frames([frames[i].pictured for i in worst], workpiece, out / "evaluation.png")
    _print(console, workpiece, data)
    console.print(f"wrote {out / 'evaluation.json'} and {out / 'evaluation.png'} (the {len(worst)} worst frames)")
    return 0


def _f1(score: FrameScore) -> float:
    return 2 * score.true_positives / max(score.n_pred + score.n_gt, 1)


def _print(console: Console, workpiece: Workpiece, data: dict[str, Any]) -> None:
    table = Table(title=f"{workpiece.name}: held-out heaps, T_e = {data['tolerance_mm']:g} mm")
    columns = ("f1_inst", "recall", "precision", "median_mm", "median_deg")
    for column in ("method", *columns, "s/frame"):
        table.add_column(column, justify="left" if column == "method" else "right")
    for name, m in data["methods"].items():
        cells = ["-" if m[c] is None else f"{m[c]:.2f}" for c in columns]
        table.add_row(name, *cells, f"{m['seconds_per_frame']['total']:.2f}")
    console.print(table)
    split = data["methods"]["ps6d_refined"]["seconds_per_frame"]
    console.print("seconds a frame: " + ", ".join(f"{k} {v:.3f}" for k, v in split.items()))
    console.print(f"expected calibration error {data['calibration']['ece']:.3f}")
