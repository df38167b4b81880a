"""A set of settled scenes in a folder: what `pickproof generate` writes, and training and evaluation read.

A scene is its seed: the folder holds poses, in the store of `load_heaps`, and `set.json` that says what they are of.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.perception.data.scenes import GENERATED_SEED, heap_fingerprint, load_heaps

SCHEMA = 1
FILE = "set.json"


@dataclass(frozen=True)
class SceneSet:
    """Scenes of one workpiece.

    Attributes:
        workpiece: its `heap.count` is the range of this set.
        folder: where the poses are stored.
        seed: of the first scene, over GENERATED_SEED; scene i has seed + i, so that a longer set begins with a shorter.
        scenes: how many.
    """

    workpiece: Workpiece
    folder: Path
    seed: int
    scenes: int

    @staticmethod
    def of(workpiece: Workpiece, folder: Path, seed: int, scenes: int, count: tuple[int, int]) -> SceneSet:
        """A set whose scenes hold `count` fewest to most workpieces, drawn uniformly."""
        heap = workpiece.heap.model_copy(update={"count": count})
        return SceneSet(replace(workpiece, heap=heap), folder, seed, scenes)

    @property
    def first_seed(self) -> int:
        """Seed of the first scene."""
        return GENERATED_SEED + self.seed

    def heaps(self, workers: int = 1, tick: Callable[[int], None] = lambda _: None) -> list[Array]:
        """Ts_world_part (n, 4, 4) in [m] of every scene; those not yet in the folder are settled and stored.

        Args:
            workers: processes; the scenes are the same for any number.
            tick: called with the number of scenes ready.
        """
        return load_heaps(self.workpiece, self.first_seed, self.scenes, self.folder, workers, tick)

    def save(self, command: str) -> None:
        """Say in the folder what it holds.

        Raises:
            InputError: it holds another set.
        """
        path = self.folder / FILE
        if path.is_file():
            before = SceneSet.load(self.folder, self.workpiece.name)
            if (before.seed, before.workpiece.heap.count) != (self.seed, self.workpiece.heap.count):
                low, high = before.workpiece.heap.count
                raise InputError(
                    path, "", f"--seed {before.seed} --count {low}:{high}", "the same set, or another --out"
                )
        self.folder.mkdir(parents=True, exist_ok=True)
        document = {
            "schema": SCHEMA,
            "workpiece": self.workpiece.name,
            "seed": self.seed,
            "scenes": self.scenes,
            "count": self.workpiece.heap.count,
            "fingerprint": heap_fingerprint(self.workpiece),
            "command": command,
        }
        path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")

    @staticmethod
    def load(folder: Path, workpiece_name: str) -> SceneSet:
        """The set in a folder.

        Raises:
            InputError: there is none, it is of another workpiece, or of one that has changed since.
        """
        path = folder / FILE
        valid = f"the folder of a set that `pickproof generate {workpiece_name}` wrote"
        try:
            stored: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            of, seed, scenes = stored["workpiece"], int(stored["seed"]), int(stored["scenes"])
            count = (int(stored["count"][0]), int(stored["count"][1]))
        except FileNotFoundError:
            raise InputError(path, "", "missing file", valid) from None
        except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
            raise InputError(path, "", str(error), valid) from None
        if stored.get("schema") != SCHEMA:
            raise InputError(path, "schema", stored.get("schema"), str(SCHEMA))
        if of != workpiece_name:
            raise InputError(path, "workpiece", of, workpiece_name)
        found = SceneSet.of(load_workpiece(of), folder, seed, scenes, count)
        if stored.get("fingerprint") != heap_fingerprint(found.workpiece):
            raise InputError(path, "fingerprint", stored.get("fingerprint"), f"scenes of {of} as it is now; {valid}")
        return found
