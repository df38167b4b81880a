"""`pickproof generate`: a set of settled scenes, from a lone workpiece to a full heap, and its export as a dataset."""

from __future__ import annotations

import argparse
import re
import shlex
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from pickproof.cell.errors import InputError
from pickproof.cell.sensing.sensor_model import SensorConfig, list_presets
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.data.bop_write import Export, export_bop
from pickproof.perception.data.contact_sheet import draw_contact_sheet
from pickproof.perception.data.scene_set import SceneSet

SPLIT = re.compile(r"(train|val|test)(_[A-Za-z0-9]+)?")
MAX_SCENES = 1_000_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `pickproof generate`."""
    parser.add_argument("workpiece")
    parser.add_argument("--scenes", type=int, default=100, help="settled scenes (default 100)")
    parser.add_argument("--seed", type=int, default=0, help="of the first scene; scene i is that of seed + i")
    parser.add_argument("--count", metavar="LOW:HIGH", help="workpieces in a scene (default 1 to the heap's most)")
    parser.add_argument("--workers", type=int, default=1, help="processes (default 1)")
    parser.add_argument("--out", type=Path, default=None, help="folder of the set (default out/data/WORKPIECE)")
    parser.add_argument(
        "--export", nargs=2, metavar=("FORMAT", "DIR"), help="write the scenes as a dataset too; the format is bop"
    )
    parser.add_argument("--views", type=int, default=1, help="images of a scene in the dataset (default 1)")
    parser.add_argument("--split", default="train", help="split of the dataset (default train)")
    sensor = parser.add_mutually_exclusive_group()
    sensor.add_argument("--sensor", metavar="PRESET", help="camera class of the dataset (default structured_light)")
    sensor.add_argument("--no-noise", action="store_true", help="exact depth in the dataset")


def main(args: argparse.Namespace) -> int:
    """`pickproof generate WORKPIECE`."""
    for option, value, least, most in (
        ("scenes", args.scenes, 1, MAX_SCENES),
        ("seed", args.seed, 0, MAX_SCENES),
        ("workers", args.workers, 1, 256),
        ("views", args.views, 1, 1000),
    ):
        if not least <= value <= most:
            raise InputError("command line", f"--{option}", value, f"{least} to {most}")
    workpiece = load_workpiece(args.workpiece)
    command = f"pickproof {shlex.join(args.words)}"
    folder = args.out or Path("out") / "data" / workpiece.name
    scenes = SceneSet.of(workpiece, folder, args.seed, args.scenes, _count(args.count, workpiece.heap.count[1]))
    export = _export(args, scenes, command)
    scenes.save(command)
    console = Console()
    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()]
    with Progress(*columns, console=console) as bar:
        settling = bar.add_task("settling scenes", total=args.scenes)
        heaps = scenes.heaps(args.workers, lambda n: bar.update(settling, completed=n))
        if export is not None:
            writing = bar.add_task("writing images", total=args.scenes)
            export_bop(export, heaps, args.workers, lambda n: bar.update(writing, completed=n))
    draw_contact_sheet(workpiece, heaps, folder / "scenes.png")
    parts = [len(poses) for poses in heaps]
    stored = sum(path.stat().st_size for path in folder.glob("heaps-*.npz"))
    console.print(
        f"{len(heaps)} scenes of {min(parts)} to {max(parts)} {workpiece.name}, {sum(parts)} poses, "
        f"{stored / 1e3:.0f} kB in {folder}; look at {folder / 'scenes.png'}",
        soft_wrap=True,
    )
    if export is not None:
        console.print(f"BOP dataset: {export.folder}, split {export.split}", soft_wrap=True)
    return 0


def _count(text: str | None, most: int) -> tuple[int, int]:
    """LOW:HIGH as numbers."""
    if text is None:
        return 1, most
    found = re.fullmatch(r"(\d+):(\d+)", text)
    low, high = (int(x) for x in found.groups()) if found else (0, 0)
    if not 1 <= low <= high:
        raise InputError("command line", "--count", text, "LOW:HIGH with 1 <= LOW <= HIGH, as 1:40")
    return low, high


def _export(args: argparse.Namespace, scenes: SceneSet, command: str) -> Export | None:
    if args.export is None:
        return None
    name, folder = args.export
    if name != "bop":
        raise InputError("command line", "--export", name, "a known format: bop")
    if not SPLIT.fullmatch(args.split):
        raise InputError("command line", "--split", args.split, "train, val or test, or one of them with _SUFFIX")
    if args.sensor is not None and args.sensor not in list_presets():
        raise InputError("command line", "--sensor", args.sensor, f"one of: {', '.join(list_presets())}")
    sensor = SensorConfig.of_preset(args.sensor) if args.sensor else SensorConfig(enabled=not args.no_noise)
    workpiece = scenes.workpiece.name
    return Export(workpiece, Path(folder), args.split, args.views, sensor, scenes.first_seed, command)
