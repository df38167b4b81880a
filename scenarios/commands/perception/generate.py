"""`pickproof generate WORKPIECE`: settled scenes, from a single workpiece to a full heap, and their export."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.arguments import Flat, Workers, WorkpieceName, about, integer, read_by
from pickproof.scenarios.commands.invocation import command_line
from pickproof.scenarios.commands.perception.arguments import NoiseOptions

if TYPE_CHECKING:
    from pickproof.perception.data.bop_write import Export
    from pickproof.perception.data.scene_set import SceneSet

SPLIT = re.compile(r"(train|val|test)(_[A-Za-z0-9]+)?")
MAX_SCENES = 1_000_000


def parse_range(text: str) -> tuple[int, int]:
    """LOW:HIGH as numbers."""
    found = re.fullmatch(r"(\d{1,9}):(\d{1,9})", text)
    low, high = (int(x) for x in found.groups()) if found else (0, 0)
    if not 1 <= low <= high:
        raise ValueError(f"{text!r} is not valid; expected LOW:HIGH with 1 <= LOW <= HIGH, as 1:40")
    return low, high


@dataclass(frozen=True, kw_only=True)
class GenerateOptions(NoiseOptions):
    """Options of `pickproof generate`; --sensor and --no-noise are of the dataset."""

    scenes: Annotated[int, integer(1, MAX_SCENES), about("settled scenes")] = 100
    seed: Annotated[int, integer(0, MAX_SCENES), about("seed of the first scene; scene i has seed + i")] = 0
    count: Annotated[
        tuple[int, int] | None,
        read_by(parse_range),
        about("LOW:HIGH workpieces in a scene; default: 1 to the heap's most", n_tokens=1),
    ] = None
    workers: Workers = 1
    out: Annotated[Path | None, about("folder of the set; default: out/data/WORKPIECE")] = None
    export: Annotated[
        tuple[Literal["bop"], Path] | None, about("FORMAT DIR: also write a dataset; the only format is bop")
    ] = None
    views: Annotated[int, integer(1, 1000), about("images per scene in the dataset")] = 1
    split: Annotated[str, about("split of the dataset")] = "train"


def generate(
    workpiece: WorkpieceName,
    /,
    *,
    options: Annotated[GenerateOptions, Flat] = GenerateOptions(),
) -> int:
    """`pickproof generate WORKPIECE`."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from pickproof.perception.data.generate import GenerateRequest
    from pickproof.perception.data.generate import generate as generate_scenes

    command = command_line()
    asked = GenerateRequest(
        workpiece, options.scenes, options.seed, options.count, options.workers, options.out, command
    )
    console = Console()
    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()]

    def export(scenes: SceneSet) -> Export:
        return _export(options, scenes, command)

    with Progress(*columns, console=console) as bar:
        settling = bar.add_task("settling scenes", total=options.scenes)
        writing = bar.add_task("writing images", total=options.scenes, visible=options.export is not None)
        made, dataset = generate_scenes(
            asked,
            export if options.export is not None else None,
            lambda n: bar.update(settling, completed=n),
            lambda n: bar.update(writing, completed=n),
        )
    parts = [len(poses) for poses in made.heaps]
    console.print(
        f"{len(parts)} scenes of {min(parts)} to {max(parts)} {workpiece}, {sum(parts)} poses, "
        f"{made.stored / 1e3:.0f} kB in {made.folder}; look at {made.folder / 'scenes.png'}",
        soft_wrap=True,
    )
    if dataset is not None:
        console.print(f"BOP dataset: {dataset.folder}, split {dataset.split}", soft_wrap=True)
    return 0


def _export(options: GenerateOptions, scenes: SceneSet, command: str) -> Export:
    from pickproof.perception.data.bop_write import Export

    assert options.export is not None
    _, folder = options.export
    if not SPLIT.fullmatch(options.split):
        raise InputError("command line", "--split", options.split, "train, val or test, or one of them with _SUFFIX")
    name = scenes.workpiece.name
    return Export(name, folder, options.split, options.views, options.sensor_config(), scenes.first_seed, command)
