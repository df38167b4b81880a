"""Judge a pull request: fails where the pick rate is shown to be worse than the committed baseline.

pytest examples/test_pick_rate.py

The first run measures the baseline, writes it beside this file and fails; commit the file. From then on a change of the
program, of the scenario or of the grasp points is compared over the same bins. docs/explanation/statistics.md says how.
"""

from __future__ import annotations

from typing import Any

import pytest

OVERRIDES = ("count=6",)
"""Changes of the scenario, as after --set: few workpieces, so that a bin takes seconds."""


@pytest.mark.grasp_rate(episodes=40)
def test_bracket(grasp_rate: Any, grasp_rate_baseline: Any) -> None:
    """First attempts with perfect poses."""
    assert grasp_rate("bracket", *OVERRIDES, oracle=["perception"]) >= grasp_rate_baseline
