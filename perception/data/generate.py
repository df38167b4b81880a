"""A set of settled scenes, from a lone workpiece to a full heap, and its export as a dataset."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from pickproof.cell.frames import Array
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.data.bop_write import Export, export_bop
from pickproof.perception.data.contact_sheet import draw_contact_sheet
from pickproof.perception.data.scene_set import SceneSet


@dataclass(frozen=True)
class GenerateRequest:
    """What is generated.

    Attributes:
        workpiece: its name.
        scenes: how many; scene i is that of seed + i.
        count: least and most workpieces in a scene; None for 1 to the heap's most.
        out: folder of the set; None for the usual one.
        command: the command line, for the record.
    """

    workpiece: str
    scenes: int = 100
    seed: int = 0
    count: tuple[int, int] | None = None
    workers: int = 1
    out: Path | None = None
    command: str = ""


@dataclass(frozen=True)
class Generated:
    """The set that was made: its folder, bytes stored in it, and poses (n, 4, 4) in [m] of each scene."""

    folder: Path
    stored: int
    heaps: Sequence[Array]


Tick = Callable[[int], None]
"""Told how many scenes are done."""


def generate(
    asked: GenerateRequest, export: Callable[[SceneSet], Export] | None, settled: Tick, written: Tick
) -> tuple[Generated, Export | None]:
    """Settle the scenes, store them, and write them as a dataset where `export` says how.

    Raises:
        InputError: no such workpiece, or the folder holds another set.
    """
    workpiece = load_workpiece(asked.workpiece)
    folder = asked.out or Path("out") / "data" / workpiece.name
    count = asked.count or (1, workpiece.heap.count[1])
    scenes = SceneSet.of(workpiece, folder, asked.seed, asked.scenes, count)
    dataset = None if export is None else export(scenes)
    scenes.save(asked.command)
    heaps = scenes.heaps(asked.workers, settled)
    if dataset is not None:
        export_bop(dataset, heaps, asked.workers, written)
    draw_contact_sheet(workpiece, heaps, folder / "scenes.png")
    stored = sum(path.stat().st_size for path in folder.glob("heaps-*.npz"))
    return Generated(folder, stored, heaps), dataset
