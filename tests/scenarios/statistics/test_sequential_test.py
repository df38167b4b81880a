import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pickproof.scenarios.statistics.sequential_test import DECISIONS, Rule, bounds, decide, evidence


@given(st.floats(0, 1), st.floats(0, 1), st.floats(-0.9, 0.9))
def test_the_bet_is_fair(low, high, share):
    """One episode's expected capital under any two-point distribution with the null's mean is at most 1."""
    mean = -low + share * (high + low)
    mean = float(np.clip(mean, -low, high))
    if high + low < 1e-6 or mean <= -0.999:
        return
    p = (mean + low) / (high + low)  # chance of `high`, of mean `mean`
    up, down = (float(np.exp(evidence(np.array([x]), mean)[-1])) for x in (high, -low))
    assert p * up + (1 - p) * down == pytest.approx(1.0, abs=1e-9)


def test_against_a_mean_that_is_lower_still_the_bet_loses():
    up, down = (float(np.exp(evidence(np.array([x]), 0.0)[-1])) for x in (1.0, -1.0))
    assert 0.4 * up + 0.6 * down < 1


def test_capital_by_hand():
    """No difference at all: the stake grows by 1 + share * margin / (1 - margin) an episode, so 156 pass a gate."""
    kinds, stops = decide(np.zeros((1, 400)), Rule())
    assert (DECISIONS[kinds[0]], stops[0]) == ("passed", 156)
    assert evidence(np.zeros(50), 0.0)[-1] == pytest.approx(0.0)
    # an all-in bet needs ln(10) / -ln(0.98) = 114; no test of this level can do with fewer
    assert stops[0] > np.log(10) / -np.log(0.98)


def test_a_look_more_changes_nothing_before_it():
    rng = np.random.default_rng(0)
    d = rng.choice([-1, 0, 1], p=[0.06, 0.93, 0.01], size=(20, 300))
    kinds, stops = decide(d, Rule())
    for i in range(20):
        if kinds[i]:
            assert decide(d[i : i + 1, : stops[i]], Rule()) == (kinds[i], stops[i])
            assert decide(d[i : i + 1, : stops[i] - 1], Rule())[0] == 0
        else:
            assert stops[i] == 300


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=1, max_size=40))
def test_bounds_hold_the_mean_and_turn_round(values):
    d = np.array(values)
    low, high = bounds(d, 0.05)
    assert -1 <= low <= d.mean() <= high <= 1
    assert bounds(-d, 0.05) == pytest.approx((-high, -low), abs=1e-4)
    assert bounds(np.zeros(0), 0.05) == (-1.0, 1.0)


def test_bad_rules():
    for bad in ({"margin": 0.0}, {"alpha": 1.0}, {"power": -0.1}):
        with pytest.raises(ValueError):
            Rule(**bad)
