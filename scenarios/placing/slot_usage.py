"""Which slots of a place bin are used, and which could not be reached, whatever kind of place it is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class SlotUsage:
    """Slots that are used, and slots that were passed over.

    Attributes:
        used: workpieces released in each slot.
        passed: how often no motion to each was found; others come first then.
        slot_of_pose: (k,) slot of each pose that `tool_poses` returned last.
    """

    used: list[int] = field(init=False)
    passed: list[int] = field(init=False)
    slot_of_pose: np.ndarray = field(init=False)

    def fill(self, pose: int) -> None:
        """Remember that a workpiece was released at the pose of this index in the last `tool_poses`."""
        self.used[self.slot_of_pose[pose]] += 1

    def pass_over(self) -> None:
        """Put other slots first next time: no motion led to those of the last `tool_poses`."""
        for slot in np.unique(self.slot_of_pose):
            self.passed[slot] += 1

    def _none_yet(self, slots: int) -> None:
        self.used, self.passed, self.slot_of_pose = [0] * slots, [0] * slots, np.zeros(0, dtype=np.intp)
