from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pickproof.scenarios.campaign.motion_times import Measured, summary
from pickproof.scenarios.commands.cli import main

pytestmark = pytest.mark.slow


def measured(steady: bool, motion: float, plan_s: float = 0.05) -> Measured:
    return Measured(steady, motion, 0.3, 1.0, 2.5, plan_s, 1e-5, 3e-5)


def test_the_cycle_is_that_of_picks_that_begin_where_another_ended() -> None:
    figures = summary([measured(False, 9.0, 0.2), measured(True, 1.4), measured(True, 1.6)])
    assert figures["cycle_s"]["mean"] == pytest.approx(1.8)
    assert figures["cycle_s"]["p95"] == pytest.approx(1.89)
    assert figures["cycle_over_bound"] == pytest.approx(1.8 / 1.3)
    assert figures["motion_over_bound"] == pytest.approx(1.5)
    assert figures["stop_at_each_s"] == pytest.approx(2.8)
    assert figures["plan_ms"]["median"] == pytest.approx(50.0)
    assert figures["plan_ms"]["p99"] == pytest.approx(197.0)


def test_real_picks_lie_between_the_bound_and_stopping_at_every_point(tmp_path: Path) -> None:
    file = tmp_path / "motion.json"
    assert main(["benchmark", "motion", "--picks", "3", "--json", str(file)]) == 0
    figures = json.loads(file.read_text())
    assert figures["picks"] == 3
    assert figures["bound_s"] < figures["cycle_s"]["mean"] <= figures["cycle_s"]["p95"] + 1e-9
    assert figures["cycle_s"]["mean"] < 0.85 * figures["stop_at_each_s"]
    assert figures["cycle_s"]["mean"] < 2.0
    assert np.isfinite([figures[k] for k in ("ik_us", "collision_us", "cycle_over_bound")]).all()


@pytest.mark.parametrize("picks", ["1", "0", "20000"])
def test_a_bad_number_of_picks_is_one_line(picks: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark", "motion", "--picks", picks]) == 2
    assert "--picks" in capsys.readouterr().err
