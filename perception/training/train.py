"""PS6D for one workpiece from streamed scenes, resumable, on the CPU or on CUDA."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.perception.data.bop_read import BopImage
from pickproof.perception.data.scenes import HEAPS_FOLDER, TRAIN_SEED, VALIDATION_SEED, load_heaps, overhead_view
from pickproof.perception.ps6d.weights import variant_path, weights_path
from pickproof.perception.training.dataset import Sample, Scene, image_sample, make_sample, stream
from pickproof.perception.training.trainer import TrainConfig, Trainer, batches

VALIDATION_HEAPS = 16
SHOW_EVERY = 10  # steps: reading the loss waits for the device


def train(
    workpiece: Workpiece,
    config: TrainConfig,
    out: Path,
    resume: bool,
    console: Console,
    command: str = "",
    given: list[Scene] | None = None,
) -> Path:
    """Train and write checkpoint, weights, record, log and curves to `out`; returns the path of the weights.

    The scenes are settled here unless they are given; the last tenth of those that are given, at most
    VALIDATION_HEAPS, validate.

    The learning rate falls as a cosine to zero at `clouds` or `minutes`, whichever comes first; resuming starts the
    cosine anew from the stored weights.
    """
    out.mkdir(parents=True, exist_ok=True)
    trainer = Trainer(workpiece, config, out, command)
    if resume:
        trainer.resume()
    scenes, validation = prepare(workpiece, config, console) if given is None else divide(workpiece, given)
    trainer.start = time.monotonic()  # settling does not count
    samples = stream(workpiece, scenes, config.seed, trainer.start_clouds, config.loaders)
    source = batches(samples, config, np.random.default_rng((config.seed, trainer.start_clouds, 1)))
    columns = [TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()]
    try:
        with Progress(*columns, console=console) as bar:
            task = bar.add_task(workpiece.name, total=1.0)
            due = trainer.clouds + config.validate_every
            while trainer.done < 1.0:
                loss = trainer.step(next(source))
                if trainer.clouds >= due or trainer.done >= 1.0:
                    due = trainer.clouds + config.validate_every
                    console.print(_line(trainer.record(validation)))
                if trainer.steps % SHOW_EVERY == 0 or trainer.done >= 1.0:
                    shown = f"{workpiece.name} on {trainer.device.type}: {trainer.clouds} clouds, loss {loss:.3f}"
                    bar.update(task, completed=trainer.done, description=shown)
    finally:
        source.close()
        samples.close()
    return out / "ps6d.safetensors"


def prepare(workpiece: Workpiece, config: TrainConfig, console: Console) -> tuple[list[Scene], list[Sample]]:
    """Settled heaps to train on, and labelled overhead views of others to validate on."""
    with Progress(TextColumn("settling heaps"), BarColumn(), MofNCompleteColumn(), console=console) as bar:
        task = bar.add_task("", total=config.heaps + VALIDATION_HEAPS)
        workers = os.cpu_count() or 1

        def heaps_of(seed: int, count: int, before: int) -> list[Array]:
            def tick(n: int) -> None:
                bar.update(task, completed=before + n)

            return load_heaps(workpiece, seed, count, HEAPS_FOLDER, workers, tick)

        held = heaps_of(VALIDATION_SEED, VALIDATION_HEAPS, 0)
        heaps = heaps_of(TRAIN_SEED, config.heaps, VALIDATION_HEAPS)
    return list(heaps), _labelled(workpiece, list(held))


def divide(workpiece: Workpiece, given: list[Scene]) -> tuple[list[Scene], list[Sample]]:
    """Scenes to train on, and labelled views of the last ones to validate on.

    Raises:
        InputError: too few, or no workpiece is seen in those that validate.
    """
    if len(given) < 2:
        raise InputError("command line", "--data or --bop", f"{len(given)} scenes", "2 or more: the last ones validate")
    held = min(max(len(given) // 10, 1), VALIDATION_HEAPS)
    validation = _labelled(workpiece, given[-held:])
    if not any(sample.keep.any() for sample in validation):
        raise InputError("command line", "--data or --bop", "no workpiece seen", "scenes in which some are visible")
    return given[:-held], validation


def _labelled(workpiece: Workpiece, scenes: list[Scene]) -> list[Sample]:
    view = overhead_view(workpiece)
    samples = []
    for i, scene in enumerate(scenes):
        rng = np.random.default_rng((7, i))
        if isinstance(scene, BopImage):
            samples.append(image_sample(workpiece, scene, rng))
        elif len(scene):
            samples.append(make_sample(workpiece, scene, view, rng))
    return [sample for sample in samples if sample is not None]


def _line(row: dict[str, float]) -> str:
    return (
        f"{row['clouds']:.0f} clouds, {row['seconds'] / 60:.1f} min: centre {row['centre']:.3f}, "
        f"rotation {row['rotation']:.3f} units, voting points right {100 * row['right']:.1f} %"
    )


def init_path(name: str, variant: str) -> Path:
    """Weights to start from: a file, or those of a workpiece."""
    if name.endswith(".safetensors"):
        return Path(name)
    return weights_of(load_workpiece(name), variant)


def weights_of(workpiece: Workpiece, variant: str) -> Path:
    """Where the weights of a variant of the network are looked for."""
    return weights_path(workpiece) if variant == "ps6d" else variant_path(workpiece, variant)


def put_to_use(path: Path, used: Path) -> str:
    """Copy weights to where the other commands read them, unless others are there; what was done in words."""
    if used.exists():
        return f"in use stay {used}; to use the new ones: cp {path} {used}"
    used.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(path, used)
    return f"in use: {used}"
