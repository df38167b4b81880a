"""Settled heaps as the cell's camera measures them, or images of a dataset, and what perception finds there, in one
process or in several."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from pickproof.cell.child_process import single_threaded_children
from pickproof.cell.frames import Array, invert
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.sensing.sensor_model import SensorConfig, measure
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.data.bop_read import BopImage
from pickproof.perception.data.scenes import HEAPS_FOLDER, heap_bin, load_heaps, overhead_view, render_heap
from pickproof.perception.estimate import Perception, method_for, shipped_score_model
from pickproof.perception.method import Method
from pickproof.perception.ps6d.weights import load_weights, weights_path
from pickproof.perception.refinement.refine import RefineConfig, RefineResult
from pickproof.perception.training.dataset import Scene


@dataclass(frozen=True)
class HeapFrame:
    """One heap or image: what was measured, what is true there and what was found.

    Attributes:
        frame: the measured depth.
        Ts_camera_part: (n, 4, 4) true poses in [m].
        pixels: (n,) pixels on which each instance is seen: of the exact render, or of the dataset's masks.
        result: what perception found.
    """

    frame: DepthFrame
    Ts_camera_part: Array
    pixels: NDArray[np.int64]
    result: RefineResult

    @cached_property
    def visibility(self) -> Array:
        """(n,) n_i / max n_i (eq. N_gt of the paper)."""
        return self.pixels / max(self.pixels.max(initial=0), 1)

    @cached_property
    def Ts_estimated(self) -> Array:
        """(p, 4, 4) verified poses in the camera frame in [m], best score first."""
        return np.array([e.T_camera_part for e in self.result.estimates]).reshape(-1, 4, 4)


@dataclass(frozen=True)
class Setup:
    """How heaps are looked at.

    Attributes:
        workpiece: its name.
        weights: None for the shipped ones.
        sensor: noise of the depth.
        seed: with the index of a heap, the seed of its noise and of its voting points.
        calibrated: with the workpiece's own score model where it has one.
        method: how poses are found.
    """

    workpiece: str
    weights: Path | None
    sensor: SensorConfig
    seed: int
    calibrated: bool = True
    method: Method = "auto"

    def check(self) -> None:
        """Read what `load` reads, without its long preparations.

        Raises:
            InputError: missing or corrupt workpiece, weights or score model.
        """
        workpiece = load_workpiece(self.workpiece)
        if method_for(workpiece, self.method, self.weights) == "search":
            return
        load_weights(self.weights or weights_path(workpiece), workpiece)
        if self.calibrated:
            shipped_score_model(workpiece)

    def load(self) -> Perception:
        """Ready to perceive."""
        config = RefineConfig.model_validate({"fit": {}})
        return Perception.load(load_workpiece(self.workpiece), self.weights, config, self.calibrated, self.method)


def perceive_scenes(setup: Setup, scenes: Sequence[Scene], workers: int = 1) -> Iterator[HeapFrame]:
    """Heaps seen from the cell's viewpoint, or images, in order and the same for any number of workers."""
    if workers == 1:
        perception = setup.load()
        for index, scene in enumerate(scenes):
            yield perceive_scene(perception, scene, setup.sensor, np.random.default_rng((setup.seed, index)))
        return
    with single_threaded_children():
        pool = ProcessPoolExecutor(min(workers, len(scenes)), mp_context=get_context("spawn"))
        try:
            yield from pool.map(_perceive, repeat(setup), range(len(scenes)), scenes)
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def perceive_seeds(
    setup: Setup, first_seed: int, count: int, workers: int, console: Console, doing: str
) -> Iterator[Iterable[HeapFrame]]:
    """Heaps of `count` seeds, settled where they are not stored and perceived, under a progress bar."""
    with _progress(console) as bar:
        settling = bar.add_task("settling heaps", total=count)

        def settled(n: int) -> None:
            bar.update(settling, completed=n)

        heaps = load_heaps(load_workpiece(setup.workpiece), first_seed, count, HEAPS_FOLDER, workers, settled)
        yield bar.track(perceive_scenes(setup, heaps, workers), count, description=doing)


@contextmanager
def perceive_given(
    setup: Setup, scenes: Sequence[Scene], workers: int, console: Console, doing: str
) -> Iterator[Iterable[HeapFrame]]:
    """Scenes of the user's own, perceived under a progress bar."""
    with _progress(console) as bar:
        yield bar.track(perceive_scenes(setup, scenes, workers), len(scenes), description=doing)


def _progress(console: Console) -> Progress:
    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()]
    return Progress(*columns, console=console)


def perceive_scene(perception: Perception, scene: Scene, sensor: SensorConfig, rng: np.random.Generator) -> HeapFrame:
    """A heap, measured by `sensor`, or an image as it is."""
    if not isinstance(scene, BopImage):
        return perceive_heap(perception, scene, sensor, rng)
    workpiece, frame = perception.workpiece, scene.frame()
    result = perception.perceive_region(frame, scene.region(frame, workpiece), rng)
    ids = scene.ids(frame, workpiece)
    pixels = np.bincount(ids[ids >= 0], minlength=len(scene.Ts_camera_part))
    return HeapFrame(frame, scene.Ts_camera_part, pixels, result)


def perceive_heap(perception: Perception, poses: Array, sensor: SensorConfig, rng: np.random.Generator) -> HeapFrame:
    """Render a heap from the cell's viewpoint, measure it and perceive it."""
    workpiece = perception.workpiece
    view = overhead_view(workpiece, sensor)
    exact = render_heap(workpiece, poses, view)
    frame = measure(exact, view.intrinsics, view.T_world_camera, sensor, rng, workpiece.optics)
    result = perception.perceive(frame, heap_bin(workpiece), rng)
    pixels = np.bincount(exact.ids[exact.ids >= 0], minlength=len(poses))
    return HeapFrame(frame, invert(view.T_world_camera) @ poses, pixels, result)


@lru_cache(maxsize=1)
def _loaded(setup: Setup) -> Perception:
    return setup.load()


def _perceive(setup: Setup, index: int, scene: Scene) -> HeapFrame:
    rng = np.random.default_rng((setup.seed, index))
    return perceive_scene(_loaded(setup), scene, setup.sensor, rng)
