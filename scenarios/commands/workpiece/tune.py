"""`pickproof tune`: searches grasp points, weights and scenario fields for a higher pick success."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.arguments import (
    FOLDER_TO_WRITE,
    SOME_PATH,
    Flat,
    ScenarioChanges,
    ScenarioName,
    about,
    integer,
    number,
    read_by,
)
from pickproof.scenarios.commands.invocation import command_line
from pickproof.scenarios.config.seeds import MAX_SEED

if TYPE_CHECKING:
    from pickproof.scenarios.tuning.plan import Plan
    from pickproof.scenarios.tuning.request import TuneRequest
    from pickproof.scenarios.tuning.run import Result

SECONDS = {"s": 1.0, "m": 60.0, "h": 3600.0}


def duration(text: str) -> float:
    """`90s`, `30m` or `1.5h` in [s]."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([smh])", text)
    if match is None or float(match[1]) <= 0:
        raise ValueError(f"{text!r} is not valid; expected a time as 90s, 30m or 2h")
    return float(match[1]) * SECONDS[match[2]]


@dataclass(frozen=True, kw_only=True)
class TuneOptions(ScenarioChanges):
    """Options of `pickproof tune`."""

    set: Annotated[
        tuple[str, ...],
        about("FIELD=LOW:HIGH searches a number of the scenario, FIELD=VALUE fixes it for old and new"),
    ] = ()
    grasps: Annotated[str, about("all, none, or names with commas")] = "all"
    shift: Annotated[float, number(0, 1000), about("largest shift of a grasp's centre along each axis, in mm")] = 8.0
    turn: Annotated[float, number(0, 1000), about("largest rotation about each axis of the tool, in degrees")] = 15.0
    errors: Annotated[Path | None, SOME_PATH, about("evaluation.json with perception's errors")] = None
    generations: Annotated[int, integer(1, 1000), about("of each grasp")] = 8
    rounds: Annotated[int, integer(1, 1000), about("of whole cells")] = 4
    episodes: Annotated[int, integer(1, 100_000), about("of a candidate")] = 8
    block: Annotated[int, integer(1, 10_000), about("episodes at a time")] = 2
    holdout: Annotated[int, integer(2, 100_000), about("unseen episodes")] = 20
    budget: Annotated[
        float | None, read_by(duration), about("time limit as 30m or 2h; stages end early to keep it")
    ] = None
    seed: Annotated[int | None, integer(0, MAX_SEED), about("default: the scenario's")] = None
    ray: Annotated[str | None, about("run campaigns on a Ray cluster, as `pickproof run` does")] = None
    out: Annotated[Path | None, FOLDER_TO_WRITE, about("default: out/tune-SCENARIO")] = None
    resume: Annotated[bool, about("continue the search in --out")] = False
    accept: Annotated[bool, about("overwrite table and scenario with the proposal in --out")] = False


def tune(
    scenario: ScenarioName,
    /,
    *,
    options: Annotated[TuneOptions, Flat] = TuneOptions(),
) -> int:
    """`pickproof tune SCENARIO`."""
    from rich.console import Console

    from pickproof.scenarios.config.scenario import scenario_path
    from pickproof.scenarios.picking.workcell import check_inputs
    from pickproof.scenarios.tuning.folder import accept_proposal, claim, write_proposal
    from pickproof.scenarios.tuning.proposal import SCENARIO, TABLE
    from pickproof.scenarios.tuning.report import print_grasps
    from pickproof.scenarios.tuning.request import plan_of

    if (options.resume or options.accept) and options.out is None:
        option = "--accept" if options.accept else "--resume"
        raise InputError("command line", option, "no --out", "--out DIR with the search")
    asked = _request(scenario, options)
    if options.accept and options.out is not None:
        doubt, written = accept_proposal(asked, options.out)
        if doubt:
            print(f"over unseen bins: {doubt}")
        print("wrote " + ", ".join(str(p) for p in written) if written else "nothing to change")
        return 0
    plan = plan_of(asked)
    source = scenario_path(scenario)
    texts = {file: file.read_text(encoding="utf-8") for file in (plan.table, source)}
    check_inputs(plan.scenario, plan.oracle)
    claim(plan, resume=options.resume)
    console = Console()
    console.print(
        f"{plan.scenario.name}: {len(plan.names)} grasps and {len(plan.fields)} fields, results in {plan.out}",
        soft_wrap=True,
    )
    try:
        result = _search(plan, console)
    except KeyboardInterrupt:
        print(
            f"pickproof: interrupted; results are kept; continue with the same options and --resume --out {plan.out}",
            file=sys.stderr,
        )
        return 130
    page = write_proposal(plan, result, source, texts)
    print_grasps(console, result)
    _print_cells(plan, result, console)
    console.print(
        f"wrote {page}, {TABLE} and {SCENARIO} beside it; accept them with --accept --out {plan.out}", soft_wrap=True
    )
    return 0


def _request(scenario: str, options: TuneOptions) -> TuneRequest:
    from pickproof.scenarios.tuning.request import TuneRequest

    given = {k: v for k, v in vars(options).items() if k not in ("set", "budget", "resume", "accept")}
    return TuneRequest(scenario=scenario, changes=options.set, budget_s=options.budget, command=command_line(), **given)


def _search(plan: Plan, console: Any) -> Result:
    """Run the plan under a progress bar with a line for each stage."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

    from pickproof.scenarios.campaign.episode import run_episode
    from pickproof.scenarios.campaign.parallel_map import mapping
    from pickproof.scenarios.tuning.optimizer import open_journal
    from pickproof.scenarios.tuning.plan import Runners
    from pickproof.scenarios.tuning.run import run_plan

    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()]
    with Progress(*columns, console=console) as bar, mapping(plan.workers) as run:
        stages: dict[str, TaskID] = {}

        def tell(stage: str, done: int, total: int) -> None:
            if stage not in stages:
                stages[stage] = bar.add_task(stage, total=None)
            bar.update(stages[stage], completed=done, total=total or None)

        return run_plan(plan, open_journal(plan.out), Runners(run, run_episode, tell=tell))


def _print_cells(plan: Plan, result: Result, console: Any) -> None:
    """The result of whole campaigns for the proposal, in words."""
    from pickproof.scenarios.comparison.compare_text import print_comparison
    from pickproof.scenarios.tuning.cell_stage import CELL

    if result.comparison is not None:
        print_comparison(console, result.comparison, plan.out / "old", plan.out / "new")
    elif not result.history[CELL]:
        console.print("the budget ended before whole cells were tried; continue with the same options and --resume")
    else:
        console.print("nothing better than the current values was found")
