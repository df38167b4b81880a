"""Spots of a place bin that are offered and filled, whatever kind of place it is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class SlotUsage:
    """What was offered, taken and passed over.

    Attributes:
        used: workpieces released at each spot.
        passed: how often each was offered and no motion to it was found; others come first then.
        offered: (k,) spot of each pose that `tool_poses` returned last.
    """

    used: list[int] = field(init=False)
    passed: list[int] = field(init=False)
    offered: np.ndarray = field(init=False)

    def fill(self, pose: int) -> None:
        """Remember that a workpiece was released at the pose of this index in the last `tool_poses`."""
        self.used[self.slot_of_pose[pose]] += 1

    def pass_over(self) -> None:
        """Offer other spots next time: no motion led to those of the last `tool_poses`."""
        for spot in np.unique(self.slot_of_pose):
            self.passed[spot] += 1

    def _none_yet(self, spots: int) -> None:
        self.used, self.passed, self.slot_of_pose = [0] * spots, [0] * spots, np.zeros(0, dtype=np.intp)
