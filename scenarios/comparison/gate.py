"""`pickproof gate`: a system against its baseline, bin by bin, until it is decided (docs/explanation/statistics.md)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array
from pickproof.scenarios.campaign.campaign import Event
from pickproof.scenarios.comparison.baseline import Baseline, Execution
from pickproof.scenarios.comparison.paired import (
    Measure,
    Outcome,
    changed_fields,
    check_same_bins,
    outcomes,
    same_seeds,
)
from pickproof.scenarios.config.input_hashes import changed, input_hashes, versions
from pickproof.scenarios.config.scenario import Scenario, scenario_json, weights_used
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord
from pickproof.scenarios.results.store import Store
from pickproof.scenarios.results.summary import percent
from pickproof.scenarios.statistics.sequential_test import DECISIONS, Decision, Rule, bounds, decide

EXIT: dict[Decision, int] = {"passed": 0, "worse": 1, "undecided": 3}
WORDS: dict[Measure, str] = {
    "first_attempt": "success of first attempts", "success": "pick success", "clearance": "clearance"
}  # fmt: skip


@dataclass(frozen=True)
class GateResult:
    """What a gate found.

    Attributes:
        episodes: paired episodes up to the decision.
        baseline, candidate: mean of the measure over them.
        bounds: of the difference, candidate minus baseline; they hold at every look with a chance of 1 - alpha.
        changed: dotted fields in which the scenario differs from the baseline's, and `oracle`, `weights_hash`,
            `inputs.` and `versions.` where those do.
    """

    decision: Decision
    measure: Measure
    rule: Rule
    episodes: int
    baseline: float
    candidate: float
    bounds: tuple[float, float]
    changed: list[str]

    @property
    def line(self) -> str:
        """The verdict in one line."""
        low, high = (f"{100 * b:+.1f}" for b in self.bounds)
        return (
            f"{self.decision}: {WORDS[self.measure]} {percent(self.baseline)} -> {percent(self.candidate)}, "
            f"between {low} and {high} points, after {self.episodes} paired episodes "
            f"(margin {100 * self.rule.margin:g} points, alpha {self.rule.alpha:g}, power {self.rule.power:g})"
        )


class _DecidedError(Exception):
    """Leaves a campaign that needs no more episodes."""


def run_gate(
    scenario: Scenario,
    baseline: Baseline,
    *,
    file: Path,
    rule: Rule,
    how: Execution,
    measure: Measure = "first_attempt",
    max_episodes: int | None = None,
    on_episode: Callable[[int], None] = lambda n: None,
) -> GateResult:
    """Run the baseline's bins one after the other until the test decides or they are used up.

    The episodes count in order of seed however they end, so the result does not depend on the number of workers.

    Args:
        file: the baseline's, for messages.
        max_episodes: at most the baseline's.
        on_episode: called with the number of episodes that count so far.

    Raises:
        InputError: the baseline is not over the bins of this scenario, or does not hold the measure.
    """
    now = {
        "oracle": sorted(how.oracle),
        "weights_hash": weights_used(scenario, how.oracle),
        "inputs": input_hashes(scenario, how.oracle),
        "versions": versions(),
    }
    different = check_gate(scenario, baseline, measure, file) + changed(baseline.model_dump(), now)
    expected = baseline.outcomes[:max_episodes]
    pairs = _Pairs(expected, rule, measure, file)
    if how.resume:
        with Store.read(how.out) as store:
            pairs.add(store.attempts(large=False), store.episodes())
    attempts: dict[int, list[AttemptRecord]] = {}

    def on_event(event: Event) -> None:
        if event.attempt is not None:
            attempts.setdefault(event.seed, []).append(event.attempt)
        elif event.episode is None:  # it is run again
            attempts.pop(event.seed, None)
        else:
            pairs.add(attempts.pop(event.seed, []), [event.episode])
            on_episode(pairs.count)
            if pairs.decision()[0] != "undecided":
                raise _DecidedError

    if pairs.decision()[0] == "undecided":
        with suppress(_DecidedError):
            how.run(scenario, measure, expected[0].seed, len(expected), on_event)
    return pairs.result(different)


def check_gate(scenario: Scenario, baseline: Baseline, measure: Measure, file: Path) -> list[str]:
    """Fields that have changed since the baseline.

    Raises:
        InputError: the two cannot be compared.
    """
    different = changed_fields(baseline.scenario, scenario_json(scenario))
    check_same_bins(different, file)
    if measure not in baseline.measures:
        raise InputError(file, "whole", False, f"a baseline of whole episodes (--whole) for --measure {measure}")
    if measure == "first_attempt":
        return [field for field in different if field != "stop.attempt_limit"]
    stop = [field for field in different if field.startswith("stop.")]
    if stop:
        raise InputError(file, ", ".join(stop), "other values", "the same stop rule in both for whole episodes")
    return different


class _Pairs:
    """Episodes of baseline and candidate, counted in order of seed up to the first that has not ended."""

    def __init__(self, expected: Sequence[Outcome], rule: Rule, measure: Measure, file: Path) -> None:
        self._expected, self._rule, self._measure, self._file = expected, rule, measure, file
        self._found: dict[int, Outcome] = {}
        self.count = 0

    def add(self, attempts: Sequence[AttemptRecord], episodes: Sequence[EpisodeRecord]) -> None:
        """Take note of episodes that ended."""
        self._found.update((o.seed, o) for o in outcomes(attempts, episodes))
        while self.count < len(self._expected) and self._expected[self.count].seed in self._found:
            self.count += 1

    def values(self) -> Array:
        """(2, count) of the measure: baseline, candidate."""
        if not self.count:
            return np.zeros((2, 0))
        sides = same_seeds(self._expected[: self.count], list(self._found.values()), self._file)
        return np.array([[o.value(self._measure) for o in side] for side in sides])

    def decision(self) -> tuple[Decision, int]:
        """What the test says, and after how many episodes."""
        values = self.values()
        kinds, stops = decide((values[1] - values[0])[None], self._rule)
        return DECISIONS[int(kinds[0])], int(stops[0])

    def result(self, changed: list[str]) -> GateResult:
        """All that is known at the decision."""
        decision, used = self.decision()
        a, b = self.values()[:, :used]
        means = (float(a.mean()), float(b.mean())) if used else (0.0, 0.0)
        return GateResult(decision, self._measure, self._rule, used, *means, bounds(b - a, self._rule.alpha), changed)


def junit(result: GateResult, name: str) -> str:
    """The result as JUnit XML: worse is a failure, undecided an error, so that no CI takes either for a pass."""
    suite = ElementTree.Element(
        "testsuite",
        name="pickproof gate",
        tests="1",
        failures=str(int(result.decision == "worse")),
        errors=str(int(result.decision == "undecided")),
        skipped="0",
    )
    case = ElementTree.SubElement(suite, "testcase", classname="pickproof.gate", name=name)
    if result.decision != "passed":
        kind = "failure" if result.decision == "worse" else "error"
        ElementTree.SubElement(
            case, kind, message=result.line, type=result.decision
        ).text = f"changed since the baseline: {', '.join(result.changed) or 'no field of the scenario'}"
    ElementTree.SubElement(case, "system-out").text = result.line
    root = ElementTree.Element("testsuites")
    root.append(suite)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
