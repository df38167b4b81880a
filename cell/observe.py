"""Ground truth for judging outcomes: where every workpiece is, and whether it lies still."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cell.bin import Bin
from cell.frames import Array
from cell.world import World

ABOVE_RIM = 0.05  # [m] that the centre of a workpiece may stand over the rim of a full bin


@dataclass(frozen=True)
class Snapshot:
    """The workpieces at one moment; indices are those of `World.parts`.

    Attributes:
        time: simulated in [s].
        Ts_world_part: (n, 4, 4), read-only.
        bins: name of the bin in which each workpiece lies, empty for none.
        at_rest: (n,) bool.
    """

    time: float
    Ts_world_part: Array
    bins: tuple[str, ...]
    at_rest: np.ndarray

    def parts_in(self, bin: str) -> tuple[int, ...]:
        """Workpieces in a bin; '' for those in none, which are held, in flight, or fell out."""
        return tuple(i for i, name in enumerate(self.bins) if name == bin)

    def left(self, before: Snapshot, bin: str) -> tuple[int, ...]:
        """Workpieces that were in `bin` before and are not now."""
        return tuple(sorted(set(before.parts_in(bin)) - set(self.parts_in(bin))))

    def moved(self, before: Snapshot) -> Array:
        """Distance (n,) in [m] of each workpiece's origin from where it was before."""
        return np.linalg.norm((self.Ts_world_part - before.Ts_world_part)[:, :3, 3], axis=1)


def observe(world: World, bins: Sequence[Bin], above: float = ABOVE_RIM) -> Snapshot:
    """Look at every workpiece.

    One is in a bin when its CAD origin is between the walls and at most `above` [m] over the rim.

    Raises:
        SimulationError: a pose is not finite.
    """
    Ts = world.part_poses()
    names = [""] * len(Ts)
    for bin in bins:
        for i in np.flatnonzero(bin.contains(Ts[:, :3, 3], above=above)):
            names[i] = bin.name
    at_rest = world.at_rest()
    Ts.flags.writeable = at_rest.flags.writeable = False
    return Snapshot(world.time, Ts, tuple(names), at_rest)
