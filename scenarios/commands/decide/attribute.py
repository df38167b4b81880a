"""`pickproof attribute SCENARIO`: loss of pick success by stage, and which stage to improve first."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.arguments import (
    FOLDER_TO_WRITE,
    Flat,
    ScenarioChanges,
    ScenarioName,
    Seed,
    about,
    integer,
)
from pickproof.scenarios.commands.invocation import command_line


@dataclass(frozen=True, kw_only=True)
class AttributeOptions(ScenarioChanges):
    """Options of `pickproof attribute`."""

    episodes: Annotated[int, integer(2, 1_000_000), about("episodes of each of four campaigns over the same bins")] = 10
    seed: Seed = None
    out: Annotated[Path | None, FOLDER_TO_WRITE, about("default: out/attribute-SCENARIO")] = None
    resume: Annotated[bool, about("continue the campaigns in --out")] = False
    json: Annotated[bool, about("print the result as JSON; progress goes to stderr")] = False


def attribute(
    scenario: ScenarioName,
    /,
    *,
    options: Annotated[AttributeOptions, Flat] = AttributeOptions(),
) -> int:
    """`pickproof attribute SCENARIO`."""
    from rich.console import Console

    from pickproof.scenarios.campaign.episode import run_episode
    from pickproof.scenarios.comparison.attribution import MODES, print_attribution
    from pickproof.scenarios.comparison.attribution_run import as_document, folder_of, run_modes
    from pickproof.scenarios.config.scenario import load_scenario
    from pickproof.scenarios.picking.workcell import check_inputs
    from pickproof.scenarios.results.broken_campaign import check_ran
    from pickproof.scenarios.results.store import FILE

    if options.oracle:
        raise InputError(
            "command line",
            "--oracle",
            " ".join(options.oracle),
            "no --oracle: the command runs all oracle modes itself",
        )
    chosen = load_scenario(scenario, list(options.set))
    if options.seed is not None:
        chosen = chosen.model_copy(update={"seed": options.seed})
    out = options.out or Path("out") / f"attribute-{chosen.name}"
    if not options.resume and any((out / folder_of(mode) / FILE).is_file() for mode in MODES):
        raise InputError("command line", "--out", str(out), "a folder without results, or --resume to continue them")
    check_inputs(chosen, frozenset())
    console, command = Console(stderr=options.json), command_line()

    def say(text: str) -> None:
        console.print(text, highlight=False)

    result = run_modes(chosen, options.episodes, options.workers, out, run_episode, command, say)
    for mode in MODES:
        check_ran(out / folder_of(mode))
    if options.json:
        print(json.dumps(as_document(result, command), indent=2))
    else:
        print_attribution(console, result)
        console.print(f"wrote {out / 'attribution.json'} and {out / 'attribution.png'}", soft_wrap=True)
    return 0
