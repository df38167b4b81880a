"""A pick rate that a test can compare: `assert grasp_rate("bracket") >= baseline`; docs/explanation/statistics.md."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path

from pickproof.scenarios.comparison.baseline import Baseline, BaselineFile, Execution, baseline_of, write_baseline
from pickproof.scenarios.comparison.gate import run_gate
from pickproof.scenarios.comparison.paired import Measure
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.results.summary import interval, percent
from pickproof.scenarios.statistics.intervals import cluster_interval, wilson
from pickproof.scenarios.statistics.sequential_test import Rule

EPISODES = 200


class GraspRateWarning(UserWarning):
    """A comparison that the episodes could not decide."""


@dataclass
class GraspRate:
    """The rate of a scenario, measured when it is compared.

    Attributes:
        episodes: at most; None for all of the baseline, or 200.
        strict: undecided counts as worse; otherwise it is a warning.
        folder: for results, one sub-folder a comparison.
    """

    scenario: Scenario
    folder: Path
    episodes: int | None = None
    workers: int = 1
    oracle: frozenset[str] = frozenset()
    measure: Measure = "first_attempt"
    rule: Rule = field(default_factory=Rule)
    strict: bool = False
    _said: list[str] = field(default_factory=list)

    def __ge__(self, other: object) -> bool:
        """Against a baseline: not shown to be worse. Against a number: the 95 % interval does not lie below it."""
        if isinstance(other, BaselineFile):
            return self._not_worse(other)
        if isinstance(other, int | float):
            return self._reaches(float(other))
        return NotImplemented

    def __repr__(self) -> str:
        return f"<grasp rate of {self.scenario.name}: {'; '.join(self._said) or 'not measured'}>"

    def write(self, baseline: BaselineFile) -> None:
        """Measure the rate as the new baseline."""
        write_baseline(baseline.path, self._measured())

    def _not_worse(self, baseline: BaselineFile) -> bool:
        result = run_gate(
            self.scenario,
            baseline.read(),
            file=baseline.path,
            rule=self.rule,
            how=self._how(),
            measure=self.measure,
            max_episodes=self.episodes,
        )
        self._said.append(result.line)
        if result.decision == "undecided" and not self.strict:
            warnings.warn(GraspRateWarning(result.line), stacklevel=3)
        return result.decision == "passed" or (result.decision == "undecided" and not self.strict)

    def _reaches(self, rate: float) -> bool:
        found = self._measured().outcomes
        if self.measure == "first_attempt":
            good, n = sum(o.first for o in found), len(found)
            low, high = wilson(good, n)
        else:
            s, m = ([o.successes for o in found], [o.attempts for o in found])
            if self.measure == "clearance":
                s, m = ([o.picked for o in found], [o.dropped for o in found])
            good, n = sum(s), sum(m)
            low, high = cluster_interval(s, m)
        self._said.append(f"{percent(good / n if n else None)}, {interval((low, high))}, {good} of {n}")
        return high >= rate if not self.strict else low >= rate

    def _measured(self) -> Baseline:
        how = self._how()
        how.run(self.scenario, self.measure, self.scenario.seed, self.episodes or EPISODES)
        return baseline_of(how.out)

    def _how(self) -> Execution:
        from pickproof.scenarios.campaign.episode import run_episode

        return Execution(self.folder / f"comparison-{len(self._said)}", run_episode, self.workers, self.oracle)
