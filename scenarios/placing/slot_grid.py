"""Where workpieces lie in a place bin: slots on a grid, in layers where one layer is too small."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from trimesh.bounds import oriented_bounds_2D

from pickproof.cell.frames import Array
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.workpiece.workpiece import Workpiece

GAP = 0.02  # [m] between workpieces that lie in lanes side by side
YAWS = 8


@dataclass(frozen=True)
class Slots:
    """A grid of slots in the frame of the bin, all alike.

    Attributes:
        centres: (n, 2) in [m].
        lane: angle of the slots' long side to the bin's x in [rad]; None where a workpiece has room in any yaw.
        layers: how many workpieces may lie on each other.
        layer: height of one in [m].
    """

    centres: Array
    lane: float | None
    layers: int
    layer: float

    @property
    def capacity(self) -> int:
        """Workpieces that have a place."""
        return len(self.centres) * self.layers

    def yaws(self, outline: Array) -> Array:
        """Turns (k,) about the vertical in [rad] in which a workpiece of outline (v, 2) [m] may lie in a slot."""
        if self.lane is None:
            return np.arange(YAWS) * 2 * np.pi / YAWS
        return self.lane - _long_side(outline) + np.array([0.0, np.pi])


def slots_in(bin: Bin, workpiece: Workpiece, count: int) -> Slots:
    """Slots for `count` workpieces: room for every yaw where one layer suffices, else the lanes that hold most.

    A slot with room for every yaw leaves the arm the choice; lanes of a slender workpiece hold several times as many.
    There is always one slot, in the middle, however small the bin is.
    """
    _, width, length = (float(side) for side in np.sort(workpiece.extents))
    layers = max(int(bin.inner[2] / width), 1)
    reach = float(np.hypot(length, width))
    free = Slots(_grid(bin, reach, reach), None, layers, width)
    if len(free.centres) >= count:
        return free
    along = Slots(_grid(bin, length + GAP, width + GAP), 0.0, layers, width)
    across = Slots(_grid(bin, width + GAP, length + GAP), np.pi / 2, layers, width)
    most = max((free, along, across), key=lambda slots: len(slots.centres))
    return most if len(most.centres) else Slots(np.zeros((1, 2)), None, layers, width)


def _grid(bin: Bin, length: float, width: float) -> Array:
    """Middles (n, 2) of as many cells of length (x) and width (y) [m] as fit, spread evenly."""
    lx, ly, _ = bin.inner
    nx, ny = int(lx / length), int(ly / width)
    xs, ys = ((np.arange(n) + 0.5) / max(n, 1) * side - side / 2 for n, side in ((nx, lx), (ny, ly)))
    return np.stack(np.meshgrid(xs, ys, indexing="ij"), -1).reshape(-1, 2)


def _long_side(outline: Array) -> float:
    """Angle in [rad] of the long side of the smallest rectangle around points (v, 2)."""
    to_box, sides = oriented_bounds_2D(outline)
    long = int(np.argmax(sides))
    return float(np.arctan2(to_box[long, 1], to_box[long, 0]))
