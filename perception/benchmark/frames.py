"""Held-out heaps seen by every method of a benchmark, in processes of one thread, and what follows of it."""

from __future__ import annotations

import copy
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import repeat
from multiprocessing import get_context
from statistics import median

import numpy as np
import torch

from pickproof.cell.child_process import single_threaded_children
from pickproof.cell.frames import Array, invert
from pickproof.cell.sensing.sensor_model import SensorConfig, measure
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.perception.benchmark.methods import Detector, Found, Method
from pickproof.perception.data.scenes import HELD_OUT_SEED, heap_bin, overhead_view, render_heap
from pickproof.perception.estimate import Perception
from pickproof.perception.evaluation.average_precision import Detections, ap_mssd, ap_sileane, visible_share
from pickproof.perception.evaluation.heap_frames import HeapFrame, Setup, perceive_heap
from pickproof.perception.evaluation.metrics import FrameScore, score_frame, summarise, visible_instances
from pickproof.perception.ps6d.cloud import roi_mask, scene_cloud
from pickproof.perception.ps6d.network import pack
from pickproof.perception.ps6d.point_hierarchy import build_levels, input_points, top_neighbours

STAGE_PARTS = (22, 28)
"""Workpieces in a heap whose stages are timed."""

FORWARD_POINTS, FORWARD_REPEATS = 8192, 10
"""Least input points of the cloud whose forward pass is timed, and how often it is."""


@dataclass(frozen=True)
class Job:
    """The methods that see a workpiece's heaps; a method sees those of index below its `frames`."""

    workpiece: str
    methods: tuple[Method, ...]
    sensor: SensorConfig


@dataclass(frozen=True)
class RowFrame:
    """One frame of one row of a table."""

    score: FrameScore
    detections: Detections
    seconds: float


Row = tuple[str, str]
"""Table and name of a row."""


def measure_rows(
    job: Job, heaps: list[Array], workers: int, tick: Callable[[], None] = lambda: None
) -> dict[Row, dict[str, float]]:
    """Figures of every row over heaps Ts_world_part (n, 4, 4); all but the seconds are the same for any `workers`.

    Args:
        tick: called after each heap.
    """
    frames: dict[Row, list[RowFrame]] = {}
    with _pool(min(workers, len(heaps))) as pool:
        for rows in pool.map(measure_heap, repeat(job), range(len(heaps)), heaps):
            for row, frame in rows.items():
                frames.setdefault(row, []).append(frame)
            tick()
    workpiece = load_workpiece(job.workpiece)
    return {row: figures(seen, workpiece) for row, seen in frames.items()}


def figures(frames: list[RowFrame], workpiece: Workpiece) -> dict[str, float]:
    """F1, recall, precision and both average precisions in per cent, mean seconds, and the number of frames."""
    s = summarise([f.score for f in frames])
    detections = [f.detections for f in frames]
    return {
        "f1_inst": 100 * s.f1_inst,
        "recall": 100 * s.recall,
        "precision": 100 * s.precision,
        "ap_sileane": 100 * ap_sileane(detections, workpiece),
        "ap_mssd": 100 * ap_mssd(detections, workpiece),
        "seconds_per_frame": float(np.mean([f.seconds for f in frames])),
        "frames": len(frames),
    }


@lru_cache(maxsize=1)
def _loaded(job: Job) -> tuple[Workpiece, list[Detector]]:
    workpiece = load_workpiece(job.workpiece)
    return workpiece, [method.load(workpiece) for method in job.methods]


def measure_heap(job: Job, index: int, poses: Array) -> dict[Row, RowFrame]:
    """One heap, measured once and shown to all methods, whose generators are alike."""
    workpiece, detectors = _loaded(job)
    view = overhead_view(workpiece, job.sensor)
    exact = render_heap(workpiece, poses, view)
    rng = np.random.default_rng((HELD_OUT_SEED, index))
    frame = measure(exact, view.intrinsics, view.T_world_camera, job.sensor, rng, workpiece.optics)
    truth = invert(view.T_world_camera) @ poses
    counted = visible_instances(np.bincount(exact.ids[exact.ids >= 0], minlength=len(poses)))
    shares = visible_share(exact, workpiece, truth, view.intrinsics)

    def scored(found: Found) -> RowFrame:
        score = score_frame(found.Ts_camera_part, truth, counted, workpiece)
        return RowFrame(score, Detections(found.Ts_camera_part, found.scores, truth, shares), found.seconds)

    rows: dict[Row, RowFrame] = {}
    for method, detect in zip(job.methods, detectors, strict=True):
        if index < method.frames:
            found = detect(frame, heap_bin(workpiece), int(counted.sum()), copy.deepcopy(rng))
            rows |= {(method.table, name): scored(f) for name, f in zip(method.rows, found, strict=True)}
    return rows


def measure_stages(setup: Setup, heaps: list[Array]) -> dict[str, object] | None:
    """Mean seconds of each stage over the heaps of `STAGE_PARTS` workpieces, in one process of one thread.

    `forward` is the network alone on the first of their clouds that has `FORWARD_POINTS` input points, else on the
    largest. None without such a heap.
    """
    chosen = [i for i, poses in enumerate(heaps) if STAGE_PARTS[0] <= len(poses) <= STAGE_PARTS[1]]
    if not chosen:
        return None
    with _pool(1) as pool:
        return pool.submit(stages_of, setup, chosen, [heaps[i] for i in chosen]).result()


def stages_of(setup: Setup, indices: list[int], heaps: list[Array]) -> dict[str, object]:
    """`measure_stages` in this process, over heaps of these indices."""
    perception = setup.load()

    def see(i: int, poses: Array) -> HeapFrame:
        return perceive_heap(perception, poses, setup.sensor, np.random.default_rng((setup.seed, i)))

    see(indices[0], heaps[0])  # the first frame of a process warms up
    seen = [see(i, poses) for i, poses in zip(indices, heaps, strict=True)]
    names = dict.fromkeys(stage for s in seen for stage in s.result.seconds if stage != "fit")  # only for figures
    seconds = {name: float(np.mean([s.result.seconds.get(name, 0.0) for s in seen])) for name in names}
    return {
        "frames": len(seen),
        "parts": float(np.mean([len(poses) for poses in heaps])),
        "seconds": seconds | {"total": sum(seconds.values())},
        "forward": _forward(perception, seen, np.random.default_rng(setup.seed)),
    }


@torch.no_grad()
def _forward(perception: Perception, seen: list[HeapFrame], rng: np.random.Generator) -> dict[str, float] | None:
    workpiece, network = perception.workpiece, perception.network
    if network is None:
        return None
    sampled = []
    for s in seen:
        cloud = scene_cloud(s.frame, roi_mask(s.frame, heap_bin(workpiece)), workpiece.unit)
        if (level0 := input_points(cloud, rng)) is not None:
            sampled.append(level0)
    large = [level0 for level0 in sampled if len(level0.points) >= FORWARD_POINTS]
    if not sampled:
        return None
    assert perception.network is not None  # stages are those of shipped weights
    level0 = large[0] if large else max(sampled, key=lambda level0: len(level0.points))
    packed = pack([build_levels(level0, rng, top_neighbours(workpiece))])
    times = []
    for _ in range(FORWARD_REPEATS + 1):  # the first does not count
        clock = time.perf_counter()
        network(packed)
        times.append(time.perf_counter() - clock)
    return {
        "input_points": len(packed.points),
        "voting_points": sum(packed.sizes),
        "median_seconds": median(times[1:]),
        "repeats": FORWARD_REPEATS,
    }


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes of one thread, which an interruption from the terminal ends without a word."""
    with single_threaded_children():
        pool = ProcessPoolExecutor(workers, get_context("spawn"), _end_when_interrupted)
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)


def _end_when_interrupted() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
