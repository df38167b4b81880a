"""Placing as the scenario wants it: what every plan of places can do, and which one a cell gets."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, apply
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.scenarios.config.placing import PatternPlace
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.placing.heap_placing import PlacePlan
from pickproof.scenarios.placing.pattern_placing import PatternPlan
from pickproof.scenarios.placing.slot_grid import slots_in


class Place(Protocol):
    """Where to put the next workpiece; see `PlacePlan` and `PatternPlan`."""

    @property
    def line(self) -> float:
        """[m] of straight line down to a pose."""

    @property
    def fall(self) -> float:
        """[m] that a workpiece falls when it is let go."""

    @property
    def rounds(self) -> int:
        """How often other slots can be offered until every one was."""

    def placeable(self, Ts_part_tool: Array) -> np.ndarray:
        """(n,) bool: held at `Ts_part_tool` (n, 4, 4), the workpiece can be put down."""

    def tool_poses(self, T_part_tool: Array, opening: float = 0.0) -> Array:
        """TCP poses (k, 4, 4) that release a workpiece held at `T_part_tool` (4, 4), most wanted first."""

    def ranks(self) -> tuple[int, ...]:
        """Rank of each pose of the last `tool_poses`; lower is better."""

    def fill(self, pose: int) -> None:
        """A workpiece was put down at this pose of the last `tool_poses`."""

    def pass_over(self) -> None:
        """Offer other slots from now on."""

    def room(self, T_world_tool: Array, opening: float) -> bool:
        """Whether the gripper, `opening` [m] open, has room at a TCP pose (4, 4)."""

    def accepts(self, off: float, turned: float) -> bool:
        """Whether a rest `off` [m] and `turned` [rad] from the wanted pose is within the tolerance."""


def place_of(scenario: Scenario, bin: Bin, workpiece: Workpiece, gripper: Gripper) -> Place:
    """The plan of places of a scenario, nothing placed yet."""
    if isinstance(scenario.place, PatternPlace):
        return PatternPlan(bin, workpiece, gripper, scenario.place)
    return PlacePlan(bin, workpiece, gripper, scenario.count)


def check_room(scenario: Scenario, workpiece: Workpiece) -> None:
    """There is a place for every workpiece.

    Raises:
        InputError: `count` is larger than the place, or cells of a pattern reach out of the place bin.
    """
    file, bin, wanted = f"scenario {scenario.name}", scenario.place_bin.build("place"), scenario.place
    if isinstance(wanted, PatternPlace):
        if wanted.cells < scenario.count:
            valid = f"rows x columns of at least count = {scenario.count}; {wanted.columns} columns make {wanted.cells}"
            raise InputError(file, "place.rows", wanted.rows, valid)
        points = apply(wanted.Ts_bin_part, workpiece.vertices).reshape(-1, 3)
        half = np.array(bin.inner[:2]) / 2
        if (np.abs(points[:, :2]) > half).any() or points[:, 2].min() < -1e-3:
            low, high = np.round(points.min(axis=0), 4).tolist(), np.round(points.max(axis=0), 4).tolist()
            valid = f"workpieces within place_bin.inner {list(bin.inner)} and over its floor"
            raise InputError(file, "place", f"workpieces from {low} to {high} m", valid)
        return
    slots = slots_in(bin, workpiece, scenario.count)
    if slots.capacity < scenario.count:
        valid = f"room for count = {scenario.count} x {workpiece.name}; it has {slots.capacity} places"
        raise InputError(file, "place_bin.inner", list(bin.inner), valid)
