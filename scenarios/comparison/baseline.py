"""`pickproof baseline`: what a system did in a row of bins, as a small JSON file to commit beside the code."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator

from pickproof.cell.config import Config, parse
from pickproof.cell.errors import InputError
from pickproof.scenarios.campaign.campaign import Event, run_campaign
from pickproof.scenarios.campaign.job import Runner
from pickproof.scenarios.campaign.request import CampaignRequest
from pickproof.scenarios.comparison.paired import MEASURES, Measure, Outcome, outcomes
from pickproof.scenarios.config.scenario import Scenario, weights_used
from pickproof.scenarios.files.atomic import write_whole
from pickproof.scenarios.results.store import FILE, Store

COLUMNS = ("seed", "dropped", "picked", "attempts", "successes", "first")


class Baseline(Config):
    """What is kept of a campaign for comparison: no poses, no pictures, one line an episode.

    Attributes:
        whole: episodes were run to their end; otherwise only their first attempt.
        scenario: the effective scenario, so that a gate can say what has changed.
        inputs: hashes of the files it names, as `input_hashes` gives them; empty in older baselines.
        rows: `COLUMNS` of each episode, at consecutive seeds.
    """

    format: Literal[1] = 1
    name: str
    scenario_hash: str
    weights_hash: str
    oracle: list[str]
    inputs: dict[str, str] = Field(default_factory=dict)
    versions: dict[str, str]
    whole: bool
    scenario: dict[str, Any]
    columns: tuple[str, ...] = COLUMNS
    rows: tuple[tuple[int, int, int, int, int, bool], ...] = Field(min_length=1)

    @field_validator("columns")
    @classmethod
    def _known(cls, columns: tuple[str, ...]) -> tuple[str, ...]:
        if columns != COLUMNS:
            raise ValueError(f"columns are {', '.join(COLUMNS)}")
        return columns

    @field_validator("rows")
    @classmethod
    def _consecutive(cls, rows: tuple[tuple[int, ...], ...]) -> tuple[tuple[int, ...], ...]:
        seeds = [row[0] for row in rows]
        if seeds != list(range(seeds[0], seeds[0] + len(seeds))):
            raise ValueError("seeds must be consecutive, in order")
        return rows

    @property
    def outcomes(self) -> list[Outcome]:
        """Of all episodes, in order of seed."""
        return [Outcome(*row) for row in self.rows]

    @property
    def measures(self) -> tuple[Measure, ...]:
        """What a gate can compare with it."""
        return MEASURES if self.whole else MEASURES[:1]


@dataclass(frozen=True)
class BaselineFile:
    """A baseline by its path, read when it is needed."""

    path: Path

    def read(self) -> Baseline:
        """The baseline in the file; raises as `read_baseline`."""
        return read_baseline(self.path)


def read_baseline(path: Path) -> Baseline:
    """Read a baseline.

    Raises:
        InputError: it is missing, no JSON, or not what `pickproof baseline` writes.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(path, "", "missing file", "a file that `pickproof baseline` wrote") from None
    except (OSError, ValueError) as error:
        raise InputError(path, "", str(error), "a JSON file that `pickproof baseline` wrote") from None
    return parse(Baseline, data, path)


def write_baseline(path: Path, baseline: Baseline) -> Path:
    """Write it with one line an episode, so that a change of it reads well in a diff."""
    head = baseline.model_dump(mode="json", exclude={"rows"})
    rows = ",\n".join("  " + json.dumps([*row[:-1], int(row[-1])]) for row in baseline.rows)
    text = json.dumps(head, indent=1, sort_keys=True).removesuffix("\n}") + f',\n "rows": [\n{rows}\n ]\n}}\n'
    return write_whole(path, text)


def baseline_of(directory: Path) -> Baseline:
    """The baseline in a campaign's results: its finished episodes from the first seed on without a gap.

    Raises:
        InputError: no episode has ended.
    """
    with Store.read(directory) as store:
        meta, found = store.meta(), outcomes(store.attempts(large=False), store.episodes())
    if not found:
        raise InputError(directory / FILE, "episodes", "none that ended", "at least one")
    first = found[0].seed
    scenario = json.loads(meta["scenario"])
    return Baseline(
        name=scenario["name"],
        scenario_hash=meta["scenario_hash"],
        weights_hash=meta["weights_hash"],
        oracle=meta["oracle"],
        inputs=meta.get("inputs", {}),
        versions=meta["versions"],
        whole=scenario["stop"]["attempt_limit"] > 1,
        scenario=scenario,
        rows=tuple(
            (o.seed, o.dropped, o.picked, o.attempts, o.successes, o.first)
            for i, o in enumerate(found)
            if o.seed == first + i
        ),
    )


def measured_as(scenario: Scenario, measure: Measure) -> Scenario:
    """The scenario as it is run for a measure: for first attempts, an episode ends after its first image."""
    if measure != "first_attempt":
        return scenario
    return scenario.model_copy(update={"stop": scenario.stop.model_copy(update={"attempt_limit": 1})})


@dataclass(frozen=True)
class Execution:
    """How episodes are run.

    Attributes:
        out: folder of their results; resume: continue those it holds.
        runner: runs one episode, in `workers` processes.
        oracle: stages replaced by ground truth.
        command: the command line, for the record.
    """

    out: Path
    runner: Runner
    workers: int = 1
    oracle: frozenset[str] = frozenset()
    resume: bool = False
    command: str = ""

    def run(
        self,
        scenario: Scenario,
        measure: Measure,
        seed: int,
        episodes: int,
        on_event: Callable[[Event], None] = lambda event: None,
    ) -> None:
        """Run the episodes from `seed` on as far as a measure needs them."""
        request = CampaignRequest(
            scenario=measured_as(scenario, measure).model_copy(update={"seed": seed}),
            episodes=episodes,
            seed=seed,
            weights_hash=weights_used(scenario, self.oracle),
            pictures=False,
            out=self.out,
            runner=self.runner,
            workers=self.workers,
            oracle=self.oracle,
            resume=self.resume,
            command=self.command,
        )
        run_campaign(request, on_event)
