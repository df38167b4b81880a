import json

import numpy as np
import pytest

from pickproof.scenarios.commands.cli import main
from pickproof.scenarios.comparison import gate_calibration as calibration
from pickproof.scenarios.statistics.sequential_test import Rule

CASES = {case.name: case for case in calibration.GATES}


@pytest.mark.parametrize("name", [n for n in CASES if n.startswith("equal")])
def test_false_alarms_under_continuous_looking(name):
    """500 gates between equals: at most 5 %, with three deviations of the simulation's own noise."""
    found = calibration.simulate_gate(CASES[name], 500, np.random.default_rng(1), Rule())
    assert found["worse"] <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 500)


def test_power_and_mean_number_of_episodes():
    found = calibration.simulate_gate(CASES["5 points worse, first attempts"], 500, np.random.default_rng(1), Rule())
    assert found["worse"] >= 0.9 and found["episodes_mean"] <= 220


def test_what_lost_the_margin_seldom_passes():
    for name in (n for n in CASES if "margin" in n):
        found = calibration.simulate_gate(CASES[name], 250, np.random.default_rng(1), Rule())
        assert found["passed"] <= 0.1 + 3 * np.sqrt(0.1 * 0.9 / 250)


def test_simulated_bins_have_the_rate_the_correlation_and_the_pairing_that_are_asked_for():
    rng = np.random.default_rng(2)
    (s, m), (s2, m2) = calibration.draw_pair(0.9, 0.8, 0.2, (1, 20_000), rng)
    assert s.sum() / m.sum() == pytest.approx(0.9, abs=0.005)
    assert s2.sum() / m2.sum() == pytest.approx(0.8, abs=0.005)
    rate = s / m  # its variance: p (1 - p) (icc + (1 - icc) / m)
    assert rate.var() == pytest.approx(0.09 * (0.2 + 0.8 * np.mean(1 / m)), rel=0.05)
    assert np.corrcoef(rate[0], (s2 / m2)[0])[0, 1] > 0.7


def test_command(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(calibration, "INTERVALS", [(10, 0.95, 0.05)])
    monkeypatch.setattr(calibration, "DIFFERENCES", [(10, 0.95, 0.95, 0.05)])
    monkeypatch.setattr(calibration, "EPISODES", 100)
    assert main(["benchmark", "gate", "--campaigns", "200", "--json", str(tmp_path / "g.json")]) == 0
    found = json.loads((tmp_path / "g.json").read_text())
    assert found["intervals"][0]["cluster"] > 0.85 and found["differences"][0]["difference"] > 0.85
    assert "least coverage" in capsys.readouterr().out
