"""Some hundred hostile command lines, drawn by seed."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tests.fuzzing.arguments import check, hostile

pytestmark = pytest.mark.slow


def test_hostile_command_lines_are_run_or_refused(tmp_path: Path) -> None:
    ends = Counter(check(hostile(np.random.default_rng(seed)), tmp_path) for seed in range(300))
    assert ends["refused"] > 200 and ends["ran"] > 5


def test_they_are_drawn_by_seed_alone() -> None:
    assert [hostile(np.random.default_rng(s)) for s in range(20)] == [
        hostile(np.random.default_rng(s)) for s in range(20)
    ]
