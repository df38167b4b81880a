"""A clock that does not count the time in which numba compiles a loop or loads it from its cache.

Otherwise the first attempt after an installation takes up to 30 s longer, and that of every process a fraction of 1 s.
"""

from __future__ import annotations

import time

from numba.core import event


class _Compiling(event.Listener):
    """Sums the time of the outermost compilations of this process."""

    def __init__(self) -> None:
        self._depth, self._begun, self._past = 0, 0.0, 0.0

    @property
    def seconds(self) -> float:
        return self._past + (time.perf_counter() - self._begun if self._depth else 0.0)

    def on_start(self, event: event.Event) -> None:
        if not self._depth:
            self._begun = time.perf_counter()
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        self._depth -= 1
        if not self._depth:
            self._past += time.perf_counter() - self._begun


_compiling = _Compiling()
event.register("numba:compiler_lock", _compiling)


def working_time() -> float:
    """Seconds since a fixed moment, without the time in which this process compiled."""
    return time.perf_counter() - _compiling.seconds
