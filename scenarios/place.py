"""Where to put the next workpiece: slots in layers, so that a free place is always at hand."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cell.bin import Bin
from cell.frames import Array, about_axis, apply, make_transform
from cell.workpiece import Workpiece

DROP = 0.010  # [m] between the workpiece's lowest point and what is believed to lie below
YAWS = 8
SLOTS_OFFERED = 3


@dataclass
class PlacePlan:
    """Slots on a grid in the place bin, filled layer by layer; what was put where is remembered, not measured.

    Attributes:
        used: workpieces released over each slot.
        offered: (k,) slot of each pose that `tool_poses` returned last.
    """

    bin: Bin
    workpiece: Workpiece
    used: list[int] = field(init=False)
    offered: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        reach = float(np.linalg.norm(np.sort(self.workpiece.extents)[-2:]))
        lx, ly, _ = self.bin.inner
        nx, ny = max(int(lx / reach), 1), max(int(ly / reach), 1)
        xs, ys = (np.arange(nx) + 0.5) / nx * lx - lx / 2, (np.arange(ny) + 0.5) / ny * ly - ly / 2
        self.slots = np.stack(np.meshgrid(xs, ys, indexing="ij"), -1).reshape(-1, 2)
        self.used = [0] * len(self.slots)
        self.offered = np.zeros(0, dtype=np.intp)
        self.layer = float(np.sort(self.workpiece.extents)[1])

    def tool_poses(self, T_part_tool: Array) -> Array:
        """TCP poses (k, 4, 4) that release a workpiece held at `T_part_tool`, most wanted first.

        The tool points straight down. The least used slots come first, each in several yaws.
        """
        T_tool_part = np.linalg.inv(T_part_tool)
        down = about_axis((1, 0, 0), np.array(np.pi))
        lowest = float((apply(down @ T_tool_part, self.workpiece.vertices))[:, 2].min())
        centre = apply(down @ T_tool_part, np.zeros((1, 3)))[0]
        order = np.argsort(self.used, kind="stable")[:SLOTS_OFFERED]
        poses, slots = [], []
        for slot in order:
            height = self.used[slot] * self.layer + DROP - lowest
            for yaw in np.arange(YAWS) * 2 * np.pi / YAWS:
                turn = about_axis((0, 0, 1), np.array(yaw))
                offset = turn[:3, :3] @ np.array([centre[0], centre[1], 0.0])
                at = (self.slots[slot][0] - offset[0], self.slots[slot][1] - offset[1], height)
                poses.append(self.bin.T_world_bin @ make_transform(t=at) @ turn @ down)
                slots.append(int(slot))
        self.offered = np.asarray(slots)
        return np.asarray(poses)

    def fill(self, pose: int) -> None:
        """Remember that a workpiece was released at the pose of this index in the last `tool_poses`."""
        self.used[self.offered[pose]] += 1
