import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenarios.statistics import Z95, cluster_interval, design_effect, wilson


def test_wilson_by_hand():
    # 8 of 10 (Agresti and Coull 1998 give 0.49 to 0.94); 0 and 10 of 10 by z^2 / (n + z^2) = 3.8415 / 13.8415
    assert wilson(8, 10) == pytest.approx((0.490162, 0.943318), abs=1e-6)
    assert wilson(0, 10) == pytest.approx((0.0, 0.277533), abs=1e-6)
    assert wilson(10, 10) == pytest.approx((0.722467, 1.0), abs=1e-6)
    assert wilson(0, 0) == (0.0, 1.0)


@given(st.integers(0, 200), st.integers(1, 200))
def test_wilson_ends_solve_the_score_equation(s, n):
    s = min(s, n)
    for bound in wilson(s, n):
        if 0 < bound < 1:
            assert abs(s / n - bound) == pytest.approx(Z95 * np.sqrt(bound * (1 - bound) / n), rel=1e-6)


def test_design_effect_by_hand():
    # two bins of 10, 10 and 5 good: p = 0.75, residuals +2.5 and -2.5, v = 2 * 12.5 / 400, binomial 0.1875 / 20
    assert design_effect([10, 5], [10, 10]) == pytest.approx(0.0625 / 0.009375)
    assert design_effect([9, 9, 9], [10, 10, 10]) == 0.0
    assert design_effect([10, 10], [10, 10]) == 1.0


def test_all_successes_is_not_certainty():
    low, high = cluster_interval([20] * 10, [20] * 10)
    assert high == 1.0
    assert 0.9 < low < wilson(200, 200)[0]
    assert cluster_interval([0] * 10, [20] * 10) == pytest.approx((1 - high, 1 - low))
    assert cluster_interval([], []) == cluster_interval([0], [0]) == (0.0, 1.0)


@given(st.lists(st.tuples(st.integers(0, 30), st.integers(0, 30)), min_size=1, max_size=12))
def test_interval_holds_the_rate_and_is_no_narrower_than_wilson(pairs):
    s, m = [min(a, b) for a, b in pairs], [b for _, b in pairs]
    low, high = cluster_interval(s, m)
    assert 0.0 <= low < high <= 1.0
    if sum(m):
        assert low - 1e-12 <= sum(s) / sum(m) <= high + 1e-12
        plain = wilson(sum(s), sum(m))
        assert high - low >= plain[1] - plain[0] - 1e-12


def test_the_same_bins_in_any_order():
    assert cluster_interval([20, 18, 17, 20, 19], [20] * 5) == cluster_interval([17, 20, 18, 19, 20], [20] * 5)


@pytest.mark.parametrize(
    ("episodes", "rate", "icc"), [(3, 0.95, 0.05), (10, 0.95, 0.05), (10, 0.99, 0.01), (10, 0.8, 0.2), (30, 0.95, 0.2)]
)
def test_coverage_with_correlated_picks(episodes, rate, icc):
    """Beta-binomial bins of 16 to 28 picks; plain Wilson covers as little as 59 % of these."""
    rng = np.random.default_rng(7)
    a, b = rate * (1 - icc) / icc, (1 - rate) * (1 - icc) / icc
    hits, runs = 0, 600
    for _ in range(runs):
        m = rng.integers(16, 29, episodes)
        low, high = cluster_interval(rng.binomial(m, rng.beta(a, b, episodes)).tolist(), m.tolist())
        hits += low <= rate <= high
    assert hits / runs >= 0.90
