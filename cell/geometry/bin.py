"""Boxes, and the bins and tables made of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pickproof.cell.frames import Array, from_rpy, invert, make_transform


@dataclass(frozen=True)
class Box:
    """A solid box: full edge lengths `size` (3,) in [m], centred at the origin of `T_world_box` (4, 4)."""

    name: str
    size: tuple[float, float, float]
    T_world_box: Array


@dataclass(frozen=True)
class Bin:
    """An open bin with vertical walls; its frame is at the centre of the inner floor, z up.

    Attributes:
        inner: inner length along x, width along y and depth along z, in [m].
        wall: thickness of walls and floor in [m].
        position: of the frame in the world, in [m].
        yaw: about world z in [rad].
    """

    name: str
    inner: tuple[float, float, float]
    wall: float
    position: tuple[float, float, float]
    yaw: float = 0.0

    @cached_property
    def T_world_bin(self) -> Array:
        """(4, 4), read-only."""
        T = from_rpy(self.position, (0.0, 0.0, self.yaw))
        T.flags.writeable = False
        return T

    def boxes(self) -> list[Box]:
        """Floor and four walls."""
        lx, ly, lz = self.inner
        w, T = self.wall, self.T_world_bin
        outer_x = lx + 2 * w

        def part(name: str, size: tuple[float, float, float], centre: tuple[float, float, float]) -> Box:
            return Box(f"{self.name}_{name}", size, T @ make_transform(t=centre))

        return [
            part("floor", (outer_x, ly + 2 * w, w), (0, 0, -w / 2)),
            part("wall_x0", (w, ly + 2 * w, lz), (-(lx + w) / 2, 0, lz / 2)),
            part("wall_x1", (w, ly + 2 * w, lz), ((lx + w) / 2, 0, lz / 2)),
            part("wall_y0", (lx, w, lz), (0, -(ly + w) / 2, lz / 2)),
            part("wall_y1", (lx, w, lz), (0, (ly + w) / 2, lz / 2)),
        ]

    def contains(self, points_world: Array, above: float = 0.0) -> np.ndarray:
        """Which points (n, 3) lie between the walls, over the floor and at most `above` [m] over the rim."""
        p = points_world @ invert(self.T_world_bin)[:3, :3].T + invert(self.T_world_bin)[:3, 3]
        lx, ly, lz = self.inner
        return (np.abs(p[:, 0]) <= lx / 2) & (np.abs(p[:, 1]) <= ly / 2) & (p[:, 2] >= -0.005) & (p[:, 2] <= lz + above)


def table(size: tuple[float, float, float], centre_top: tuple[float, float, float]) -> Box:
    """A table as a solid box whose top face is centred at `centre_top` [m]."""
    x, y, z = centre_top
    return Box("table", size, make_transform(t=(x, y, z - size[2] / 2)))
