"""`pickproof baseline`: measures a system and writes its baseline."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pickproof.scenarios.commands.arguments import (
    FILE_TO_WRITE,
    FOLDER_TO_WRITE,
    Flat,
    ScenarioChanges,
    Seed,
    about,
    integer,
)
from pickproof.scenarios.commands.invocation import command_line

if TYPE_CHECKING:
    from pickproof.scenarios.comparison.baseline import Baseline


@dataclass(frozen=True, kw_only=True)
class BaselineOptions(ScenarioChanges):
    """Options of `pickproof baseline`."""

    baseline: Annotated[Path | None, FILE_TO_WRITE, about("default: NAME.baseline.json")] = None
    episodes: Annotated[int, integer(1, 100_000), about("bins")] = 200
    seed: Seed = None
    whole: Annotated[bool, about("run whole episodes, not only their first attempts")] = False
    out: Annotated[Path | None, FOLDER_TO_WRITE, about("results of the run; default: out/baseline-SCENARIO")] = None
    resume: Annotated[bool, about("continue the run in --out")] = False


def baseline(
    source: Annotated[str, about("a scenario to run, or the folder of a finished campaign")],
    /,
    *,
    options: Annotated[BaselineOptions, Flat] = BaselineOptions(),
) -> int:
    """`pickproof baseline SCENARIO|DIR`."""
    from pickproof.scenarios.comparison.baseline import baseline_of, write_baseline
    from pickproof.scenarios.results.store import FILE

    folder = Path(source)
    found = baseline_of(folder) if (folder / FILE).is_file() else _run(source, options)
    path = write_baseline(options.baseline or Path(f"{found.name}.baseline.json"), found)
    first = sum(o.first for o in found.outcomes)
    print(f"wrote {path}: {len(found.rows)} episodes, {first} first attempts succeeded")
    return 0


def _run(name: str, options: BaselineOptions) -> Baseline:
    from pickproof.scenarios.campaign.episode import run_episode
    from pickproof.scenarios.comparison.baseline import Execution, baseline_of
    from pickproof.scenarios.config.scenario import load_scenario
    from pickproof.scenarios.picking.workcell import check_inputs
    from pickproof.scenarios.results.broken_campaign import check_ran

    scenario = load_scenario(name, list(options.set))
    oracle = frozenset[str](options.oracle)
    check_inputs(scenario, oracle)
    out = options.out or Path("out") / f"baseline-{scenario.name}"
    how = Execution(out, run_episode, options.workers, oracle, options.resume, command_line())
    seed = scenario.seed if options.seed is None else options.seed
    how.run(scenario, "success" if options.whole else "first_attempt", seed, options.episodes)
    check_ran(out)
    return baseline_of(out)
