"""Settled heaps: poses are simulated once and stored; every image of them is rendered on the fly."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from pickproof.cell.errors import InputError, SimulationError
from pickproof.cell.frames import Array, about_axis
from pickproof.cell.geometry.bin import Bin, Box, table
from pickproof.cell.sensing.camera import Intrinsics, Render, RenderOptions, look_at, render
from pickproof.cell.sensing.sensor_model import SensorConfig, random_sensor
from pickproof.cell.workpiece.workpiece import HeapConfig, Workpiece, load_workpiece

TRAIN_SEED, VALIDATION_SEED, HELD_OUT_SEED, GENERATED_SEED = 1_000_000, 2_000_000, 3_000_000, 4_000_000
"""First seeds of the sets; a heap's seed alone makes its poses, so the sets never share a heap."""
FLOOR = 0.01  # [m] height of the bin floor over the table
HEAPS_FOLDER = Path("out") / "heaps"
"""Where settled heaps are kept, below the folder that a command is called in."""
FINGERPRINT = "fingerprint"
"""Key under which a file of heaps says what they were made of."""


@dataclass(frozen=True)
class View:
    """A camera over a heap."""

    intrinsics: Intrinsics
    T_world_camera: Array
    sensor: SensorConfig


def heap_bin(workpiece: Workpiece) -> Bin:
    """The bin in which a workpiece's heaps lie, at the world's origin."""
    inner = workpiece.heap.bin_inner
    return Bin("bin", inner, max(0.006, 0.02 * max(inner)), (0.0, 0.0, FLOOR))


def heap_boxes(workpiece: Workpiece) -> list[Box]:
    """Everything but the workpieces that a camera over a heap sees."""
    span = 3 * max(workpiece.heap.bin_inner)
    return [table((span, span, 0.05), (0.0, 0.0, 0.0)), *heap_bin(workpiece).boxes()]


def settle_heap(workpiece: Workpiece, seed: int) -> Array:
    """Ts_world_part (n, 4, 4) of one settled heap; a random count in the workpiece's range."""
    from pickproof.cell.physics.bin_filling import fill_bin  # loads PyBullet, which rendering stored heaps does without
    from pickproof.cell.physics.world import World

    for attempt in range(5):  # now and then a part keeps rocking; such a heap is thrown away
        rng = np.random.default_rng((seed, attempt))
        count = int(rng.integers(workpiece.heap.count[0], workpiece.heap.count[1] + 1))
        world = World()
        try:
            for box in heap_boxes(workpiece):
                world.add_box(box)
            heap = fill_bin(world, workpiece, heap_bin(workpiece), count, rng)
            return heap.Ts_world_part[heap.inside]
        except SimulationError:
            continue
        finally:
            world.close()
    raise SimulationError(f"no heap of {workpiece.name} with seed {seed} came to rest in 5 tries")


def _settle_named(name: str, heap: HeapConfig, seed: int) -> Array:
    return settle_heap(replace(load_workpiece(name), heap=heap), seed)


def load_heaps(
    workpiece: Workpiece,
    first_seed: int,
    count: int,
    folder: Path,
    workers: int,
    tick: Callable[[int], None] = lambda _: None,
) -> list[Array]:
    """Heaps of seeds first_seed .. first_seed + count - 1, from `folder` where stored, else settled and stored.

    Heaps stored for a workpiece that has changed since are settled anew.

    Args:
        tick: called with the number of heaps ready, for a progress display.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"heaps-{workpiece.name}-{first_seed}.npz"
    known: dict[str, Array] = {}
    if path.is_file():
        try:
            with path.open("rb") as file, np.load(file) as stored:
                known = {key: stored[key] for key in stored.files}
        except (OSError, ValueError, EOFError, BadZipFile, zlib.error) as error:
            raise InputError(path, "", str(error), "a file of settled heaps; delete it to settle them anew") from None
    seeds = range(first_seed, first_seed + count)
    made_of = heap_fingerprint(workpiece)
    if str(known.pop(FINGERPRINT, "")) != made_of:
        known = {}
    missing = [seed for seed in seeds if str(seed) not in known]
    tick(count - len(missing))
    if missing:
        pool = ProcessPoolExecutor(max(workers, 1), mp_context=get_context("spawn"))
        try:
            settled = pool.map(_settle_named, repeat(workpiece.name), repeat(workpiece.heap), missing)
            for seed, poses in zip(missing, settled, strict=True):
                known[str(seed)] = poses
                tick(sum(str(s) in known for s in seeds))
                if len(known) % 20 == 0:
                    _store(path, known, made_of)
        finally:  # an interrupted run keeps what it has
            if known:
                _store(path, known, made_of)
            pool.shutdown(cancel_futures=True)
    return [known[str(seed)] for seed in seeds]


def heap_fingerprint(workpiece: Workpiece) -> str:
    """First 16 hex digits of the SHA-256 of all of a workpiece on which its heaps depend."""
    body = [np.round(x, 9).tolist() for x in (workpiece.extents, workpiece.mass, workpiece.com, workpiece.inertia)]
    hulls = [np.round(hull.vertices, 9).tolist() for hull in workpiece.collision_hulls]
    plain = (workpiece.collision_boxes, workpiece.collision_cylinders, workpiece.heap)
    # without teeth as it was before there were any: heaps take hours to settle
    rubbing = (workpiece.friction, workpiece.rolling_friction)
    of = (body, rubbing if workpiece.rolling_friction else workpiece.friction, hulls, plain)
    return hashlib.sha256(repr(of).encode()).hexdigest()[:16]


def _store(path: Path, known: dict[str, Array], made_of: str) -> None:
    part = path.with_suffix(".part.npz")  # a run that is killed while it writes leaves the old file whole
    arrays: dict[str, Any] = dict(known)  # numpy before 2.1 has no allow_pickle here, and its types want one
    arrays[FINGERPRINT] = np.array(made_of)
    np.savez_compressed(part, **arrays)
    part.replace(path)


def random_view(workpiece: Workpiece, rng: np.random.Generator) -> View:
    """A training view: tilt to 20 degrees, any roll, distance and noise over a range, 0.7 to 1 mm a pixel."""
    inner = workpiece.heap.bin_inner
    distance = workpiece.heap.camera_distance * rng.uniform(0.8, 1.2)
    T = _tilted(distance, rng)
    width = int(rng.integers(340, 500))
    # the bin's diagonal fills the image, so that any roll shows all of it
    fov = 2 * np.arctan(np.hypot(inner[0], inner[1]) / 2 / distance) * 1.02
    return View(Intrinsics.from_fov(width, width, fov), T, random_sensor(rng))


def _tilted(distance: float, rng: np.random.Generator) -> Array:
    """T_world_camera [m] of a camera that looks at the bin's floor: tilt to 20 degrees, any roll."""
    tilt, azimuth, roll = np.deg2rad(20) * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi)
    direction = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
    target = np.array([0.0, 0.0, FLOOR])
    return look_at(target + distance * direction, target) @ about_axis((0, 0, 1), roll)


def overhead_view(workpiece: Workpiece, sensor: SensorConfig | None = None) -> View:
    """The cell's view: 640 x 480 straight from above, the bin filling the image."""
    inner, distance = workpiece.heap.bin_inner, workpiece.heap.camera_distance
    fov = 2 * np.arctan(max(inner[0], inner[1] * 4 / 3) / 2 * 1.15 / distance)
    T = look_at(np.array([0.0, 0.0, FLOOR + distance]), np.array([0.0, 0.0, FLOOR]))
    return View(Intrinsics.from_fov(640, 480, fov), T, sensor or SensorConfig())


def tilted_view(workpiece: Workpiece, rng: np.random.Generator, sensor: SensorConfig | None = None) -> View:
    """The cell's camera moved: tilt to 20 degrees, any roll, 1.1 to 1.3 times as far off; its intrinsics stay."""
    view = overhead_view(workpiece, sensor)
    return replace(view, T_world_camera=_tilted(workpiece.heap.camera_distance * rng.uniform(1.1, 1.3), rng))


def render_heap(workpiece: Workpiece, poses: Array, view: View, threads: int = 1) -> Render:
    """Exact render of a heap from a view."""
    return render(
        workpiece.vertices,
        workpiece.faces,
        poses,
        heap_boxes(workpiece),
        view.intrinsics,
        view.T_world_camera,
        RenderOptions(view.sensor.projector_offset, view.sensor.sees_reflections(workpiece.optics), threads),
    )
