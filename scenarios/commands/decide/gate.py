"""`pickproof gate`: a system against its baseline."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.arguments import (
    FILE_TO_WRITE,
    FOLDER_TO_WRITE,
    FRACTION,
    SOME_PATH,
    Flat,
    ScenarioChanges,
    ScenarioName,
    about,
    integer,
)
from pickproof.scenarios.commands.invocation import command_line

Measure = Literal["first_attempt", "success", "clearance"]
"""`comparison.paired.MEASURES` as a type; a test holds them equal."""


@dataclass(frozen=True, kw_only=True)
class GateOptions(ScenarioChanges):
    """Options of `pickproof gate`; the defaults of margin, alpha and power are those of `Rule`."""

    baseline: Annotated[Path, SOME_PATH, about("file written by `pickproof baseline`")]
    measure: Annotated[Measure, about("measure that is compared")] = "first_attempt"
    margin: Annotated[float, FRACTION, about("loss that the gate must detect")] = 0.02
    alpha: Annotated[float, FRACTION, about("probability of a false alarm")] = 0.05
    power: Annotated[float, FRACTION, about("probability of detecting a loss of the margin")] = 0.9
    max_episodes: Annotated[
        int | None, integer(1, 100_000), about("largest number of episodes; default: all of the baseline")
    ] = None
    out: Annotated[Path | None, FOLDER_TO_WRITE, about("default: out/gate-SCENARIO")] = None
    resume: Annotated[bool, about("continue the gate in --out")] = False
    json: Annotated[Path | None, FILE_TO_WRITE, about("write the result to this file as JSON")] = None
    junit: Annotated[Path | None, FILE_TO_WRITE, about("write the result to this file as JUnit XML")] = None


def gate(scenario: ScenarioName, /, *, options: Annotated[GateOptions, Flat]) -> int:
    """`pickproof gate SCENARIO --baseline FILE`: exit code 0 passed, 1 worse, 3 undecided."""
    from rich.console import Console

    from pickproof.scenarios.campaign.episode import run_episode
    from pickproof.scenarios.comparison.baseline import Execution, read_baseline
    from pickproof.scenarios.comparison.gate import EXIT, check_gate, junit, run_gate
    from pickproof.scenarios.config.scenario import load_scenario
    from pickproof.scenarios.files.atomic import free_folder, write_json, write_whole
    from pickproof.scenarios.picking.workcell import check_inputs
    from pickproof.scenarios.results.broken_campaign import check_ran
    from pickproof.scenarios.results.store import FILE
    from pickproof.scenarios.statistics.sequential_test import Rule

    chosen, baseline = load_scenario(scenario, list(options.set)), read_baseline(options.baseline)
    oracle = frozenset[str](options.oracle)
    check_gate(chosen, baseline, options.measure, options.baseline)
    check_inputs(chosen, oracle)
    if options.resume and not (options.out and (options.out / FILE).is_file()):
        raise InputError("command line", "--resume", str(options.out), "--out DIR with the results to continue")
    out = options.out or free_folder(Path("out") / f"gate-{chosen.name}")
    with Console(stderr=True).status("no episodes yet") as status:
        result = run_gate(
            chosen,
            baseline,
            file=options.baseline,
            rule=Rule(options.margin, options.alpha, options.power),
            how=Execution(out, run_episode, options.workers, oracle, options.resume, command_line()),
            measure=options.measure,
            max_episodes=options.max_episodes,
            on_episode=lambda n: status.update(f"{n} paired episodes"),
        )
    check_ran(out)
    if options.json:
        write_json(options.json, {**asdict(result), "scenario": chosen.name, "exit_code": EXIT[result.decision]})
    if options.junit:
        write_whole(options.junit, junit(result, chosen.name))
    print(result.line)
    return EXIT[result.decision]
