"""Judge a pull request: the test fails if the pick rate is significantly worse than the committed baseline.

pytest examples/test_pick_rate.py

The first run measures the baseline, writes it beside this file and fails; commit that file. Later runs compare a change
of the code, the scenario or the grasp points over the same bins; see docs/explanation/statistics.md.
"""

from __future__ import annotations

from typing import Any

import pytest

OVERRIDES = ("count=6",)
"""Changes of the scenario, as with --set: few workpieces, so that a bin takes seconds."""


@pytest.mark.grasp_rate(episodes=40)
def test_bracket(grasp_rate: Any, grasp_rate_baseline: Any) -> None:
    """Judge first attempts, with poses from ground truth."""
    assert grasp_rate("bracket", *OVERRIDES, oracle=["perception"]) >= grasp_rate_baseline
