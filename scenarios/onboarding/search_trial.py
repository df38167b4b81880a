"""What the search finds of a new part without any training, on settled heaps of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pickproof.cell.errors import SimulationError
from pickproof.cell.frames import Array
from pickproof.cell.sensing.sensor_model import SensorConfig
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.data.scenes import VALIDATION_SEED, settle_heap
from pickproof.perception.estimate import Perception
from pickproof.perception.evaluation.heap_frames import perceive_heap
from pickproof.perception.evaluation.metrics import FrameScore, Summary, score_frame, summarise, visible_instances

HEAPS, HEAPS_COMPLEX = 8, 4
SIMPLE = 8
"""Collision pieces up to which a part settles quickly; parts of more get fewer heaps."""
ENOUGH = 0.97
"""F1 from which training gains next to nothing: the shipped networks reach 0.97 to 1 on the shipped parts."""


@dataclass(frozen=True)
class SearchTrial:
    """Figures of the search.

    Attributes:
        heaps: how many were looked at.
        instances: workpieces in them that are to be found.
        summary: of all frames, shares in [0, 1].
        seconds: mean wall time of a frame.
    """

    heaps: int
    instances: int
    summary: Summary
    seconds: float

    @staticmethod
    def of(workpiece: Workpiece, say: Callable[[str], None]) -> SearchTrial:
        """Settle heaps, measure and search them; the same for the same part."""
        count = HEAPS if len(workpiece.pieces) <= SIMPLE else HEAPS_COMPLEX
        say(f"looking at {count} heaps without training")
        heaps = [poses for i in range(count) if (poses := _settled(workpiece, VALIDATION_SEED + i)) is not None]
        perception = Perception.load(workpiece, method="search")
        scores: list[FrameScore] = []
        seconds = 0.0
        for i, poses in enumerate(heaps):
            seen = perceive_heap(perception, poses, SensorConfig(), np.random.default_rng((VALIDATION_SEED, i)))
            counted = visible_instances(seen.pixels)
            scores.append(score_frame(seen.Ts_estimated, seen.Ts_camera_part, counted, workpiece))
            seconds += sum(seen.result.seconds.values()) / len(heaps)
        return SearchTrial(len(heaps), sum(s.n_gt for s in scores), summarise(scores), seconds)

    @property
    def worth_training(self) -> bool:
        """Whether a trained network can be expected to find clearly more."""
        return self.instances == 0 or self.summary.f1_inst < ENOUGH

    @property
    def line(self) -> str:
        """All of it in one line."""
        if self.instances == 0:
            return "search without training: no heap came to rest, so nothing is known of it"
        s = self.summary
        advice = "training is worth trying" if self.worth_training else "training is not needed"
        return (
            f"search without training: F1 {100 * s.f1_inst:.1f} %, precision {100 * s.precision:.1f} % on "
            f"{self.instances} workpieces in {self.heaps} heaps, {self.seconds:.2f} s a frame; {advice}"
        )

    def record(self) -> dict[str, float | int | bool]:
        """For onboard.json; shares in per cent."""
        s = self.summary
        return {
            "heaps": self.heaps,
            "instances": self.instances,
            "f1_inst": 100 * s.f1_inst,
            "recall": 100 * s.recall,
            "precision": 100 * s.precision,
            "seconds_per_frame": self.seconds,
            "worth_training": self.worth_training,
        }


def _settled(workpiece: Workpiece, seed: int) -> Array | None:
    """A heap, or None where none comes to rest."""
    try:
        return settle_heap(workpiece, seed)
    except SimulationError:
        return None
