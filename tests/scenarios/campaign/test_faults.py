"""A small storm; `python -m tests.benchmarks.faults` is the long one."""

import numpy as np
import pytest

from tests.benchmarks.faults import SLOW, storm

pytestmark = pytest.mark.slow


def test_kills_of_workers_and_driver_lose_and_double_nothing(tmp_path):
    words = [*SLOW, "--episodes", "5", "--workers", "2"]
    found = storm(tmp_path, 4, np.random.default_rng(3), words, driver_share=0.4, moment_s=3.0)
    assert found.kills["worker"] and found.kills["driver"] and found.kills.total() == 4
    assert found.harmless, found
