"""A few small settled heaps of brackets, made once a session, and a heaps folder filled with them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.perception.data.scenes import heap_fingerprint, settle_heap


@lru_cache(maxsize=1)
def bracket() -> Workpiece:
    return load_workpiece("bracket")


@lru_cache(maxsize=1)
def small_heaps() -> list[Array]:
    """Three heaps of 8 to 12."""
    fewer = bracket().heap.model_copy(update={"count": (8, 12)})
    return [settle_heap(replace(bracket(), heap=fewer), seed) for seed in range(3)]


def fill_folder(folder: Path, first_seed: int, count: int) -> None:
    """Store small heaps under the seeds that a run will ask for, in place of settling full ones."""
    folder.mkdir(parents=True, exist_ok=True)
    heaps = small_heaps()
    named = {str(first_seed + i): heaps[i % len(heaps)] for i in range(count)}
    made_of = np.array(heap_fingerprint(bracket()))
    np.savez_compressed(folder / f"heaps-bracket-{first_seed}.npz", **named, fingerprint=made_of)
