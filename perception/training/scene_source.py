"""Scenes of the user's own in place of those that training and evaluation settle."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pickproof.cell.errors import InputError
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.data.bop_read import read_bop
from pickproof.perception.data.scene_set import SceneSet
from pickproof.perception.training.dataset import Scene


@dataclass(frozen=True)
class SceneSource:
    """Where scenes come from; settled by the command itself where nothing is said.

    Attributes:
        data: folder of scenes that `pickproof generate` settled.
        bop: folder of a BOP dataset; split, sensor and obj of it, None for the only one.
    """

    data: Path | None = None
    bop: Path | None = None
    split: str | None = None
    sensor: str | None = None
    obj: int | None = None

    def scenes(self, workpiece: Workpiece, workers: int) -> list[Scene] | None:
        """The scenes; None for those that the command settles itself.

        Raises:
            InputError: no such scenes.
        """
        for option, value in (("--split", self.split), ("--bop-sensor", self.sensor), ("--obj", self.obj)):
            if value is not None and self.bop is None:
                raise InputError("command line", option, value, "to stand beside --bop DIR")
        if self.bop is not None:
            if not self.bop.is_dir():
                raise InputError("command line", "--bop", str(self.bop), "the folder of a BOP dataset")
            return list(read_bop(self.bop, self.split, self.obj, workpiece, self.sensor))
        if self.data is not None:
            return list(SceneSet.load(self.data, workpiece.name).heaps(workers))
        return None
