"""Wall time of the stages of a computation."""

from __future__ import annotations

import time


class StageClock:
    """Adds up wall time by stage; `seconds` maps each stage to its total in [s]."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Count the time since the last lap to `stage`."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self._last = now
