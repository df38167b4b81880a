from __future__ import annotations

import time

import numba
import numpy as np

from pickproof.cell.clock import working_time


def test_compiling_does_not_count_and_work_does() -> None:
    @numba.njit
    def total(values: np.ndarray) -> float:
        found = 0.0
        for value in values:
            found += np.sin(value) ** 2
        return found

    def spent(n: int) -> tuple[float, float]:
        begun, worked = time.perf_counter(), working_time()
        total(np.arange(n, dtype=np.float64))
        return time.perf_counter() - begun, working_time() - worked

    by_clock, at_work = spent(1)
    assert 0.0 <= at_work < 0.2 * by_clock  # the first call compiles
    by_clock, at_work = spent(20_000_000)
    assert abs(by_clock - at_work) < 0.01 * by_clock  # the second one does not
