"""The search of `pickproof tune` on objectives whose optimum is known, without physics."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickproof.scenarios.comparison.paired import Outcome
from pickproof.scenarios.tuning.optimizer import Parameter, Search, Told, Trial, Values, open_journal, run_searches
from pickproof.scenarios.tuning.racing import counts_of_all, pooled, race

pytestmark = pytest.mark.slow

OPTIMUM = {"x": 4.0, "y": -3.0, "z": 2.0, "n": 3}
PARAMETERS = [Parameter(name, -8, 8, 0.0, star=True) for name in "xyz"] + [Parameter("n", 0, 5, 0, integer=True)]


def bowl(values: Values) -> float:
    """0 at the optimum, -38 at the start."""
    return -sum((values[name] - at) ** 2 for name, at in OPTIMUM.items())


def searched(
    folder: Path, evaluate: Callable[[str, Values], float] = lambda _, v: bowl(v), generations: int = 8, seed: int = 0
) -> list[Trial]:
    journal = open_journal(folder)
    searches = {name: Search(journal, name, PARAMETERS, seed) for name in ("a", "b")}
    run_searches(searches, lambda asked: [Told(evaluate(n, v), {}) for n, v in asked], 6, generations)
    return searches["a"].trials


def test_the_optimum_is_found(tmp_path: Path) -> None:
    trials = searched(tmp_path)
    assert trials[0].values == {p.name: p.start for p in PARAMETERS} and trials[0].value == bowl(trials[0].values)
    best = max(trials, key=lambda t: t.value)
    rng = np.random.default_rng(0)
    blind = [{p.name: rng.uniform(p.low, p.high) for p in PARAMETERS} for _ in trials]
    assert best.value > max(map(bowl, blind)) and best.value > bowl(trials[0].values) / 10
    assert all(p.low <= t.values[p.name] <= p.high for t in trials for p in PARAMETERS)
    assert all(t.values["n"] == int(t.values["n"]) for t in trials)


def test_an_interrupted_search_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    whole = searched(tmp_path / "whole", generations=5)
    calls = 0

    def interrupted(name: str, values: Values) -> float:
        nonlocal calls
        calls += 1
        if calls == 41:
            raise KeyboardInterrupt
        return bowl(values)

    with pytest.raises(KeyboardInterrupt):
        searched(tmp_path / "cut", interrupted, generations=5)
    resumed = searched(tmp_path / "cut", generations=5)
    assert [(t.generation, t.values, t.value) for t in resumed] == [(t.generation, t.values, t.value) for t in whole]
    assert searched(tmp_path / "cut", generations=5) == resumed  # nothing is left to do
    assert [t.values for t in searched(tmp_path / "other", generations=5, seed=1)] != [t.values for t in whole]


def test_importance_names_what_matters(tmp_path: Path) -> None:
    journal = open_journal(tmp_path)
    search = Search(journal, "one", PARAMETERS, 0)
    run_searches({"one": search}, lambda asked: [Told(-((v["y"] + 3) ** 2), {}) for _, v in asked], 6, 8)
    shares = search.importances()
    assert max(shares, key=lambda name: shares[name]) == "y"


def bins(chance: float, n: int) -> list[Outcome]:
    """Ten attempts a bin; every candidate meets the same luck, and a lower chance fails in more places."""
    found = []
    for seed in range(n):
        luck = np.random.default_rng(seed).random(10)
        good = int((luck < chance).sum())
        found.append(Outcome(seed, 10, good, 10, good, bool(luck[0] < chance)))
    return found


def test_losers_leave_the_race_early_and_the_best_runs_until_it_is_clear() -> None:
    asked: dict[float, int] = {}

    def outcomes(chance: float, n: int) -> list[Outcome]:
        asked[chance] = max(asked.get(chance, 0), n)
        return bins(chance, n)

    finished = race([0.1, 0.85, 0.95], 0.8, outcomes, 3, 24)
    best = finished[0.95]
    assert finished[0.1].dropped and finished[0.85].dropped and not best.dropped
    assert finished[0.1].episodes < best.episodes == asked[0.8] < 24  # nobody is left to be told apart
    gain = pooled(bins(0.95, best.episodes)) - pooled(bins(0.8, best.episodes))
    assert best.gain == pytest.approx(gain) and 0 < best.interval95[0] < gain < best.interval95[1]
    alike = race([0.1, 0.95], 0.949, outcomes, 3, 24)
    assert alike[0.1].episodes < 24 and alike[0.95].episodes == asked[0.949] == 24


def test_neither_never_moving_nor_endless_trying_looks_good() -> None:
    idle, stubborn = Outcome(0, 10, 2, 2, 2, True), Outcome(0, 10, 10, 40, 10, False)
    steady = Outcome(0, 10, 9, 10, 9, True)
    assert counts_of_all([idle]) == ([2], [10]) and counts_of_all([stubborn]) == ([10], [40])
    assert pooled([steady]) > max(pooled([idle]), pooled([stubborn]))


@pytest.mark.parametrize("stop", ["enqueued", "asked", "half told"])
def test_wherever_it_stops_it_goes_on_with_the_same_trials(
    tmp_path: Path, stop: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The number of a trial is its place among those told: the start is 0 also where the first were lost."""
    whole = searched(tmp_path / "whole", generations=3)
    search = Search(open_journal(tmp_path / "cut"), "a", PARAMETERS, 0)
    if stop == "enqueued":
        search._study.enqueue_trial({p.name: p.start for p in PARAMETERS})
    else:
        asked = search.ask(6)
        if stop == "half told":
            told, left = search._study.tell, iter([True, True, False])

            def tell(trial: Any, value: float) -> None:
                if not next(left):
                    raise KeyboardInterrupt
                told(trial, value)

            monkeypatch.setattr(search._study, "tell", tell)
            with pytest.raises(KeyboardInterrupt):
                search.tell(asked, [Told(bowl(dict(t.params)), {}) for t in asked])
    assert searched(tmp_path / "cut", generations=3) == whole


def test_a_race_runs_all_the_bins_that_were_asked_for() -> None:
    asked: list[int] = []

    def outcomes(key: str, n: int) -> list[Outcome]:
        asked.append(n)
        return [Outcome(seed, 5, 4, 5, 4, True) for seed in range(n)]

    assert race(["a"], "start", outcomes, 3, 8)["a"].episodes == 8
    assert sorted(set(asked)) == [3, 6, 8]
