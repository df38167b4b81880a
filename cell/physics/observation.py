"""Ground truth for judging outcomes: pose of every workpiece, and whether it is at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.physics.world import World

TOUCH = 0.001  # [m] between a workpiece and a wall that it lies on
ABOVE_RIM = 0.05  # [m] that the centre of a workpiece may stand over the rim of a full bin


@dataclass(frozen=True)
class Snapshot:
    """The workpieces at one moment; indices are those of `World.parts`.

    Attributes:
        time: simulated in [s].
        Ts_world_part: (n, 4, 4), read-only.
        bins: name of the bin in which each workpiece lies, empty for none.
        at_rest: (n,) bool.
        on_rim: workpieces that lie on the top of a bin's wall, wherever their origin is.
    """

    time: float
    Ts_world_part: Array
    bins: tuple[str, ...]
    at_rest: np.ndarray
    on_rim: tuple[int, ...] = ()

    def parts_in(self, bin: str) -> tuple[int, ...]:
        """Workpieces in a bin; '' for those in none, which are held, falling, or fell out."""
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
    return Snapshot(world.time, Ts, tuple(names), at_rest, _on_rim(world, bins, Ts))


def _on_rim(world: World, bins: Sequence[Bin], Ts_world_part: Array) -> tuple[int, ...]:
    """Workpieces that touch the top of a wall; computed again, since Bullet keeps no contacts of sleeping bodies."""
    found = set()
    for bin in bins:
        rim = bin.position[2] + bin.inner[2]
        walls = [body for name, body in world.boxes.items() if name.startswith(f"{bin.name}_wall_")]
        for i, workpiece in enumerate(world.workpieces):
            if Ts_world_part[i, 2, 3] + np.linalg.norm(workpiece.extents) < rim:
                continue
            for wall in walls:
                points = world.client.getClosestPoints(world.parts[i], wall, TOUCH)
                # the normal on the wall points to the workpiece
                if any(p[6][2] > rim - TOUCH and p[7][2] > 0.7 for p in points):
                    found.add(i)
    return tuple(sorted(found))
