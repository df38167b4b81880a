"""Placing to a pattern: one workpiece in each cell of a grid, in the pose that the scenario wants."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pickproof.cell.frames import Array, apply, make_transform
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.clearance import OpenGripper
from pickproof.scenarios.config.placing import PatternPlace
from pickproof.scenarios.placing.heap_placing import ABOVE, MAX_LEAN, SLOTS_AT_ONCE
from pickproof.scenarios.placing.slot_usage import SlotUsage

HOVER = 0.001  # [m] over the wanted pose at which a workpiece is let go
SAMPLES = 1500  # points of the surface that stand for a workpiece that was placed


@dataclass
class PatternPlan(SlotUsage):
    """The cells of a pattern, filled row after row; what was put where is remembered, not measured.

    Attributes:
        lean: (k,) of the tool from the vertical in each pose that `tool_poses` returned last, in [rad].
    """

    bin: Bin
    workpiece: Workpiece
    gripper: Gripper
    pattern: PatternPlace
    lean: Array = field(init=False)

    def __post_init__(self) -> None:
        self.wanted = self.bin.T_world_bin @ self.pattern.Ts_bin_part
        self._none_yet(len(self.wanted))
        self.lean = np.zeros(0)
        self._equivalents = make_transform(self.workpiece.symmetry.rotations())
        self._surface = self.workpiece.sample_surface(SAMPLES, seed=6)[0]

    @property
    def line(self) -> float:
        """[m] of straight line down to a pose: over the rim, and over the workpieces that were placed."""
        heights = apply(self.pattern.Ts_bin_part, self.workpiece.vertices)[..., 2]
        return max(self.bin.inner[2], float(heights.max())) + ABOVE

    @property
    def fall(self) -> float:
        """[m] that a workpiece falls when it is let go."""
        return HOVER

    @property
    def rounds(self) -> int:
        """How often `pass_over` brings other cells until every free one was tried."""
        return -(-self.used.count(0) // SLOTS_AT_ONCE)

    def placeable(self, Ts_part_tool: Array) -> np.ndarray:
        """(n,) bool: held so (n, 4, 4), the workpiece can be put down in a cell of an empty bin.

        Some symmetric equivalent of the wanted pose leans the tool by MAX_LEAN at most and keeps the gripper off floor
        and walls. Where it is false the workpiece would have to be gripped anew.
        """
        shape, can = OpenGripper.of(self.gripper.boxes(0.0)), np.zeros(len(Ts_part_tool), dtype=bool)
        for cell in self._spread():
            Ts = self._over(cell) @ Ts_part_tool[:, None]
            good = self._upright(Ts)
            good[good] = ~shape.hits_bin(Ts[good], self.bin)
            can |= good.any(axis=1)
        return can

    def tool_poses(self, T_part_tool: Array, opening: float = 0.0) -> Array:
        """TCP poses (k, 4, 4) that release a workpiece held at `T_part_tool`, in free cells, first ones first.

        Every symmetric equivalent of the wanted pose is among them for which the gripper, `opening` [m] open, has room
        beside bin and workpieces placed before.
        """
        free = np.flatnonzero(np.array(self.used) == 0)
        order = free[np.argsort(np.array(self.passed)[free], kind="stable")][:SLOTS_AT_ONCE]
        shape = OpenGripper.of(self.gripper.boxes(opening))
        poses, cells = [np.zeros((0, 4, 4))], list[int]()
        for cell in order:
            Ts = self._tools(int(cell), T_part_tool, shape)
            Ts = Ts[~shape.hits_points(Ts, self._placed())]
            poses.append(Ts)
            cells += [int(cell)] * len(Ts)
        Ts_world_tool = np.concatenate(poses)
        self.slot_of_pose = np.asarray(cells, dtype=np.intp)
        self.lean = np.arccos(np.clip(-Ts_world_tool[:, 2, 2], -1.0, 1.0))
        return Ts_world_tool

    def ranks(self) -> tuple[int, ...]:
        """Of each pose in the last `tool_poses`: earlier cells first, there what leans least, to 5 degrees."""
        order = {int(cell): i for i, cell in enumerate(dict.fromkeys(self.slot_of_pose.tolist()))}
        steps = np.rint(np.rad2deg(self.lean) / 5.0).astype(int)
        return tuple(100 * order[int(cell)] + int(step) for cell, step in zip(self.slot_of_pose, steps, strict=True))

    def room(self, T_world_tool: Array, opening: float) -> bool:
        """Whether the gripper, `opening` [m] open, keeps off the bin and what was placed before."""
        shape, Ts = OpenGripper.of(self.gripper.boxes(opening)), T_world_tool[None]
        return not (shape.hits_bin(Ts, self.bin)[0] or shape.hits_points(Ts, self._placed())[0])

    def accepts(self, off: float, turned: float) -> bool:
        """Whether what rests `off` [m] and `turned` [rad] from its wanted pose lies within the tolerance."""
        return 1000 * off <= self.pattern.tolerance_mm and np.rad2deg(turned) <= self.pattern.tolerance_deg

    def _tools(self, cell: int, T_part_tool: Array, shape: OpenGripper) -> Array:
        """TCP poses (k, 4, 4) over one cell that lean little and keep the gripper off the bin."""
        Ts = self._over(cell) @ T_part_tool
        Ts = Ts[self._upright(Ts)]
        return Ts[~shape.hits_bin(Ts, self.bin)]

    def _over(self, cell: int) -> Array:
        """Ts_world_part (s, 4, 4) in which a workpiece is let go over a cell: all that its symmetry makes equal."""
        return np.asarray(make_transform(t=(0.0, 0.0, HOVER)) @ self.wanted[cell] @ self._equivalents)

    @staticmethod
    def _upright(Ts_world_tool: Array) -> np.ndarray:
        """(...) bool: the tool leans by MAX_LEAN at most."""
        return np.asarray(-Ts_world_tool[..., 2, 2] >= np.cos(MAX_LEAN))

    def _spread(self) -> list[int]:
        """A cell in the middle, and those at the corners: where walls are nearest."""
        last, columns = len(self.wanted) - 1, self.pattern.columns
        middle = columns * (self.pattern.rows // 2) + columns // 2
        return list(dict.fromkeys([middle, 0, columns - 1, last - columns + 1, last]))

    def _placed(self) -> Array:
        """Points (n, 3) on the workpieces that were placed, as wanted."""
        cells = np.flatnonzero(self.used)
        return np.asarray(apply(self.wanted[cells], self._surface)).reshape(-1, 3)
