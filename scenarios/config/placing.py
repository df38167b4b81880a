"""What a scenario says about placing: a heap in layers, or a pattern."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from pickproof.cell.config import Config, Length, OffsetPoint, Point
from pickproof.cell.frames import Array, from_rpy, make_transform

Triple = tuple[float, float, float]


class HeapPlace(Config):
    """Heap placing: slots in layers in the place bin, each workpiece in a resting pose."""

    kind: Literal["heap"] = "heap"


class PatternPlace(Config):
    """One workpiece in each cell of a grid on the floor of the place bin, in a given pose."""

    kind: Literal["pattern"] = Field(description="a grid")
    rows: int = Field(ge=1, le=100, description="cells along the fixture's y")
    columns: int = Field(ge=1, le=100, description="cells along the fixture's x")
    pitch: tuple[Length, Length] = Field(description="[m] between the centres of cells along x and y")
    position: Point = Field(default=(0.0, 0.0, 0.0), description="[m] centre of the grid in the place bin's frame")
    yaw_deg: float = Field(default=0.0, description="[deg] rotation of the fixture about the place bin's z")
    part_position: OffsetPoint = Field(
        description="[m] of the CAD frame in its cell, of T_fixture_part; z from the floor"
    )
    part_rpy_deg: Triple = Field(default=(0.0, 0.0, 0.0), description="[deg] of the CAD frame in its cell, fixed axes")
    tolerance_mm: float = Field(default=3.0, gt=0, description="[mm] allowed horizontal error of the pose")
    tolerance_deg: float = Field(
        default=5.0, gt=0, le=180, description="[deg] allowed rotation error, symmetry considered"
    )

    @property
    def cells(self) -> int:
        """Number of workpieces that have a place."""
        return self.rows * self.columns

    @property
    def Ts_bin_part(self) -> Array:
        """Target poses (cells, 4, 4) in the place bin's frame, row by row from the fixture's -y."""
        T_bin_fixture = from_rpy(self.position, (0.0, 0.0, float(np.deg2rad(self.yaw_deg))))
        T_cell_part = from_rpy(self.part_position, np.deg2rad(self.part_rpy_deg))
        xs, ys = ((np.arange(n) - (n - 1) / 2) * p for n, p in zip((self.columns, self.rows), self.pitch, strict=True))
        return np.stack([T_bin_fixture @ make_transform(t=(x, y, 0.0)) @ T_cell_part for y in ys for x in xs])


PlaceConfig = Annotated[HeapPlace | PatternPlace, Field(discriminator="kind")]
