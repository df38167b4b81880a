import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar
from scipy.stats import beta

from pickproof.scenarios.statistics.intervals import (
    Z95,
    cluster_interval,
    cluster_intervals,
    difference_interval,
    pair_interval,
    wilson,
)


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


def test_bins_of_one_pick_are_independent_picks():
    """The likelihood of the correlation is flat: Jeffreys' interval of a binomial rate, no narrower than Wilson's."""
    s = [1] * 180 + [0] * 20
    low, high = cluster_interval(s, [1] * 200)
    jeffreys, plain = beta.ppf((0.025, 0.975), 180.5, 20.5), wilson(180, 200)
    assert low == pytest.approx(min(jeffreys[0], plain[0]), abs=5e-4)
    assert high == pytest.approx(max(jeffreys[1], plain[1]), abs=5e-4)


def test_all_successes_is_not_certainty():
    low, high = cluster_interval([20] * 10, [20] * 10)
    assert high == 1.0
    assert 0.9 < low < wilson(200, 200)[0]
    assert cluster_interval([0] * 10, [20] * 10) == pytest.approx((1 - high, 1 - low))
    assert cluster_interval([], []) == cluster_interval([0], [0]) == (0.0, 1.0)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 30), st.integers(0, 30)), min_size=1, max_size=12))
def test_interval_holds_the_rate_and_is_no_narrower_than_wilson(pairs):
    s, m = [min(a, b) for a, b in pairs], [b for _, b in pairs]
    low, high = cluster_interval(s, m)
    assert 0.0 <= low < high <= 1.0
    if sum(m):
        plain = wilson(sum(s), sum(m))
        assert low <= plain[0] <= sum(s) / sum(m) <= plain[1] <= high


def test_the_same_bins_in_any_order():
    assert cluster_interval([20, 18, 17, 20, 19], [20] * 5) == pytest.approx(
        cluster_interval([17, 20, 18, 19, 20], [20] * 5)
    )


def test_many_episodes_make_it_narrow():
    """10,000 attempts at 95 %, no correlation: at most a fifth wider than Wilson's."""
    s = np.random.default_rng(3).binomial(25, 0.95, 400)
    low, high = cluster_interval(s.tolist(), [25] * 400)
    plain = wilson(int(s.sum()), 10_000)
    assert high - low < 1.2 * (plain[1] - plain[0])


@pytest.mark.parametrize(
    ("episodes", "rate", "icc"), [(3, 0.95, 0.05), (10, 0.95, 0.2), (10, 0.99, 0.01), (5, 0.8, 0.2), (20, 0.95, 0.2)]
)
def test_coverage_with_correlated_picks(episodes, rate, icc):
    """Beta-binomial bins; plain Wilson covers as little as 59 % of these. 500 campaigns: 0.945 less two deviations."""
    rng = np.random.default_rng(7)
    m = rng.integers(20, 26, (500, episodes))
    a, b = rate * (1 - icc) / icc, (1 - rate) * (1 - icc) / icc
    low, high = cluster_intervals(rng.binomial(m, rng.beta(a, b, m.shape)), m).T
    assert np.mean((low <= rate) & (rate <= high)) >= 0.925


def test_pair_interval_inverts_the_score_test():
    """At either end the score statistic, with the nuisance maximised by brute force, is z."""
    better, worse, n = 3, 14, 120
    for d in pair_interval(better, worse, n):

        def log_likelihood(q, d=d):  # chance q that only the first is right, q + d that only the second is
            return -(better * np.log(q + d) + worse * np.log(q) + (n - better - worse) * np.log(1 - 2 * q - d))

        q = minimize_scalar(log_likelihood, bounds=(max(0, -d) + 1e-12, (1 - d) / 2 - 1e-12), method="bounded").x
        z = (better - worse - n * d) / np.sqrt(n * (2 * q + d * (1 - d)))
        assert abs(z) == pytest.approx(Z95, rel=1e-3)


@given(st.integers(0, 20), st.integers(0, 20), st.integers(0, 100))
def test_pair_interval_holds_the_difference_and_turns_round(better, worse, same):
    n = better + worse + same
    low, high = pair_interval(better, worse, n)
    assert -1 <= low < high <= 1
    if n:
        assert low < (better - worse) / n < high or max(better, worse) == n
    assert pair_interval(worse, better, n) == pytest.approx((-high, -low), abs=1e-9)


def test_difference_interval_of_paired_episodes():
    first, second = ([20, 18, 25, 22], [24, 20, 26, 23]), ([19, 18, 22, 20], [24, 20, 26, 23])
    low, high = difference_interval(first, second)
    assert low < (79 - 85) / 93 < high
    assert difference_interval(second, first) == pytest.approx((-high, -low))
    same = difference_interval(first, first)
    assert same[0] == pytest.approx(-same[1]) and same[1] > 0.02  # four equal episodes are no proof of equality
    assert difference_interval(([5], [6]), ([6], [6])) == (-1.0, 1.0)
