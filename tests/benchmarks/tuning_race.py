"""Is the race of `pickproof tune` worth its code? `python -m tests.benchmarks.tuning_race --rounds 2000`.

Four candidates with drawn pick rates and the start they are compared with empty the same drawn bins; the outcomes are
drawn, not simulated, so that the true rates are known. The race of `pickproof tune`, two pruners of Optuna and no
pruning at all decide how many bins each candidate is given and which one is taken. Printed are the bins used, the pick
rate lost by taking another than the best, and how often one is taken that is worse than the start.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

import numpy as np
import optuna
from optuna.pruners import BasePruner, NopPruner, SuccessiveHalvingPruner, WilcoxonPruner

from pickproof.cell.frames import Array
from pickproof.scenarios.comparison.paired import Outcome
from pickproof.scenarios.tuning.racing import pooled, race

CANDIDATES, BLOCK, EPISODES, COUNT = 4, 2, 8, 6
START = 0  # index of the reference among the drawn rates

Outcomes = Callable[[int, int], list[Outcome]]


def drawn_outcomes(rates: Array, rng: np.random.Generator) -> Outcomes:
    """(candidate, n) -> its first n bins; a bin is hard or easy for all candidates alike (logit spread 0.7)."""
    ease = rng.normal(0.0, 0.7, EPISODES)
    picked = np.empty((len(rates), EPISODES, 2), dtype=int)
    for k, rate in enumerate(rates):
        p = 1.0 / (1.0 + np.exp(-(np.log(rate / (1.0 - rate)) + ease)))
        good = rng.binomial(COUNT, p)
        picked[k] = np.stack([good, COUNT - good], axis=1)

    def of(candidate: int, n: int) -> list[Outcome]:
        return [
            Outcome(seed, COUNT, int(good), int(good + bad), int(good), bool(good))
            for seed, (good, bad) in enumerate(picked[candidate, :n])
        ]

    return of


def by_race(outcomes: Outcomes) -> tuple[int, int]:
    """Candidate taken and bins used, by the race of `pickproof tune`."""
    finished = race(range(1, CANDIDATES + 1), START, outcomes, BLOCK, EPISODES)
    used = sum(f.episodes for f in finished.values()) + max(f.episodes for f in finished.values())
    able = {key: f.gain * f.episodes / (f.episodes + 2) for key, f in finished.items() if not f.dropped}
    best = max(able, key=lambda k: able[k], default=START)
    return (best if able and able[best] > 0 else START), used


def by_pruner(make: Callable[[], BasePruner]) -> Callable[[Outcomes], tuple[int, int]]:
    """The same by a pruner: the start first, then one candidate after the other, a block reported at a time."""

    def run(outcomes: Outcomes) -> tuple[int, int]:
        study = optuna.create_study(direction="maximize", pruner=make())
        used, means = 0, {}
        for key in range(CANDIDATES + 1):
            trial = study.ask()
            bins = outcomes(key, EPISODES)
            for n in range(1, EPISODES + 1):
                used += 1
                # Wilcoxon's pruner wants the value of each bin, successive halving the mean so far
                whole = isinstance(study.pruner, WilcoxonPruner)
                trial.report(bins[n - 1].value("success") if whole else pooled(bins[:n]), step=n)
                if n % BLOCK == 0 and n < EPISODES and trial.should_prune():
                    study.tell(trial, state=optuna.trial.TrialState.PRUNED)
                    break
            else:
                means[key] = pooled(bins)
                study.tell(trial, means[key])
        return max(means, key=lambda k: (means[k], -k), default=START), used

    return run


WAYS: dict[str, Callable[[Outcomes], tuple[int, int]]] = {
    "race of tune": by_race,
    "successive halving": by_pruner(lambda: SuccessiveHalvingPruner(min_resource=BLOCK, reduction_factor=2)),
    "Wilcoxon": by_pruner(lambda: WilcoxonPruner(p_threshold=0.1, n_startup_steps=BLOCK)),
    "no pruning": by_pruner(NopPruner),
}


def main() -> int:
    """Run it; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=2000)
    args = parser.parse_args()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    for title, spread in (("candidates near the start", 0.5), ("candidates far apart", 1.5)):
        print(title)
        sums = {label: np.zeros(3) for label in WAYS}
        for seed in range(args.rounds):
            rng = np.random.default_rng(seed)
            logits = 0.8 + np.concatenate([[0.0], rng.normal(0.0, spread, CANDIDATES)])
            rates = 1.0 / (1.0 + np.exp(-logits))
            outcomes = drawn_outcomes(rates, rng)
            for label, way in WAYS.items():
                taken, used = way(outcomes)
                sums[label] += [used, rates.max() - rates[taken], rates[taken] < rates[START]]
        for label, row in sums.items():
            used, lost, worse = row / args.rounds
            shares = f"{100 * lost:5.2f} points lost, {100 * worse:5.1f} % worse than start"
            print(f"  {label:20} {used:5.1f} bins, {shares}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
