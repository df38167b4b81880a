"""The search: parameters with bounds, evaluated in generations of a fixed size, stored in Optuna's journal.

The points of a generation depend only on the seed and the earlier generations, not on the number of workers or on
interruptions. Half of a generation comes from Optuna's TPE, which looks everywhere, the other half steps from the best
one known, ever less far; the first one tries the start and one parameter at a time.
"""

from __future__ import annotations

import hashlib
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution
from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

JOURNAL = "search.journal"
STAR = 0.75  # of the range on each side of the start, where one parameter is moved alone
STEP, SHRINK, LEAST = 0.2, 0.75, 0.02  # of the range: deviation of the first steps, factor a generation, smallest one

Values = dict[str, float]


@dataclass(frozen=True)
class Parameter:
    """A number that the search may choose; `star` asks for it to be tried alone first."""

    name: str
    low: float
    high: float
    start: float
    integer: bool = False
    star: bool = False

    @property
    def distribution(self) -> BaseDistribution:
        """The range as Optuna takes it."""
        if self.integer:
            return IntDistribution(math.ceil(self.low), math.floor(self.high))
        return FloatDistribution(self.low, self.high)

    def within(self, value: float) -> float:
        """The nearest value that is allowed."""
        inside = min(max(value, self.low), self.high)
        return float(round(inside)) if self.integer else inside


@dataclass(frozen=True)
class Told:
    """What a trial came to; larger values are better. `detail` is kept beside it, as JSON."""

    value: float
    detail: dict[str, Any]


@dataclass(frozen=True)
class Trial:
    """A trial that has been told; `number` is its place among those, 0 for the start."""

    number: int
    generation: int
    values: Values
    value: float
    detail: dict[str, Any]


def open_journal(folder: Path) -> JournalStorage:
    """The journal of a folder; every search of it is a study in there."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    folder.mkdir(parents=True, exist_ok=True)
    return JournalStorage(JournalFileBackend(str(folder / JOURNAL)))


class Search:
    """The search over some parameters, continued where the journal knows it.

    Args:
        given: points that are tried in the first generation, after the start.
    """

    def __init__(
        self,
        journal: JournalStorage,
        name: str,
        parameters: Sequence[Parameter],
        seed: int,
        given: Sequence[Values] = (),
    ) -> None:
        self.parameters, self._seed, self._name = tuple(parameters), seed, name
        self._study = optuna.create_study(storage=journal, study_name=name, direction="maximize", load_if_exists=True)
        self._after_interruption()
        self._given = [{p.name: p.start for p in self.parameters}, *given]

    @property
    def given(self) -> int:
        """How many points the first generation began with: the start and those given."""
        return len(self._given)

    @property
    def trials(self) -> list[Trial]:
        """Those told, in their order."""
        found = self._study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        return [
            Trial(number, t.user_attrs["generation"], dict(t.params), float(t.value), t.user_attrs["detail"])
            for number, t in enumerate(found)
            if t.value is not None
        ]

    @property
    def generation(self) -> int:
        """How many have been told."""
        return max((t.generation for t in self.trials), default=-1) + 1

    @property
    def best(self) -> Trial | None:
        """Of the largest value; the earliest of equal ones."""
        return max(self.trials, key=lambda t: (t.value, -t.number), default=None)

    def run_generation(self, size: int, evaluate: Callable[[list[Values]], Sequence[Told]]) -> None:
        """Ask for one generation, evaluate it, tell it whole."""
        self.tell(asked := self.ask(size), evaluate([dict(t.params) for t in asked]))

    def ask(self, size: int) -> list[optuna.Trial]:
        """The trials of the next generation; the first one has as many as its fixed points need."""
        generation = self.generation
        rng = np.random.default_rng((self._seed, generation, *_digits(self._name)))
        self._study.sampler = optuna.samplers.TPESampler(
            seed=int(rng.integers(2**31)), multivariate=True, n_startup_trials=2 * size, constant_liar=True
        )
        fixed = self._first(size) if generation == 0 else self._steps(size // 2, generation, rng)
        spaces = {p.name: p.distribution for p in self.parameters}
        asked = []
        for values in [*fixed, *([None] * (size - len(fixed)))]:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
                if values is not None:
                    self._study.enqueue_trial({p.name: p.within(values[p.name]) for p in self.parameters})
                trial = self._study.ask(spaces)
            trial.set_user_attr("generation", generation)
            asked.append(trial)
        return asked

    def tell(self, asked: Sequence[optuna.Trial], told: Sequence[Told]) -> None:
        """What became of a generation, in its order."""
        for trial, result in zip(asked, told, strict=True):
            trial.set_user_attr("detail", result.detail)
            trial.set_user_attr("value", result.value)
        for trial, result in zip(asked, told, strict=True):
            self._study.tell(trial, result.value)

    def importances(self) -> dict[str, float]:
        """Share of each parameter in what sets the best tenth apart (PED-ANOVA); empty where nothing can be said."""
        values = {t.value for t in self.trials}
        if len(self.trials) < 10 or len(values) < 2 or len(self.parameters) < 2:
            return {}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            return dict(get_param_importances(self._study, evaluator=PedAnovaImportanceEvaluator()))

    def _after_interruption(self) -> None:
        """Fail trials that were never evaluated; complete a generation whose results were stored in part."""
        for _ in self._study.get_trials(deepcopy=False, states=(TrialState.WAITING,)):
            self._study.ask()  # takes the one that waits
        begun = {t.generation for t in self.trials}
        for trial in self._study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
            if trial.user_attrs.get("generation") in begun:
                self._study.tell(trial.number, trial.user_attrs["value"])
            else:
                self._study.tell(trial.number, state=TrialState.FAIL)

    def _first(self, size: int) -> list[Values]:
        points = list(self._given)
        for p in self.parameters:
            if p.star:
                for end in (p.low, p.high):
                    points.append(self._given[0] | {p.name: p.start + STAR * (end - p.start)})
        return points

    def _steps(self, count: int, generation: int, rng: np.random.Generator) -> list[Values]:
        best = self.best
        assert best is not None
        deviation = max(STEP * SHRINK ** (generation - 1), LEAST)
        steps = rng.normal(0.0, deviation, (count, len(self.parameters)))
        # in high dimensions a step along all axes at once seldom gains: each takes about half of them
        steps *= rng.random(steps.shape) < max(0.5, 1.5 / len(self.parameters))
        return [
            {p.name: best.values[p.name] + s * (p.high - p.low) for p, s in zip(self.parameters, row, strict=True)}
            for row in steps
        ]


def run_searches(
    searches: Mapping[str, Search],
    evaluate: Callable[[list[tuple[str, Values]]], Sequence[Told]],
    size: int,
    generations: int,
    go_on: Callable[[], bool] = lambda: True,
    on_generation: Callable[[], None] = lambda: None,
) -> None:
    """Several searches side by side, a generation of each at a time, until all have had their generations.

    Args:
        evaluate: (name of the search, values) of every trial to what each came to, in their order.
        go_on: asked before each round; false ends the search early.
    """
    while go_on():
        due = {name: s for name, s in searches.items() if s.generation < generations}
        if not due:
            return
        asked = {name: search.ask(size) for name, search in due.items()}
        told = iter(evaluate([(name, dict(t.params)) for name, trials in asked.items() for t in trials]))
        results = {name: [next(told) for _ in trials] for name, trials in asked.items()}
        for name, search in due.items():
            search.tell(asked[name], results[name])
        on_generation()


def _digits(name: str) -> list[int]:
    return list(hashlib.sha256(name.encode()).digest()[:8])
