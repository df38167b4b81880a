"""`pickproof run SCENARIO`: a campaign, its results file and its summary."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pickproof.cell.errors import InputError
from pickproof.perception.method import Method
from pickproof.scenarios.commands.arguments import (
    FOLDER_TO_WRITE,
    Flat,
    ScenarioFields,
    ScenarioName,
    Seed,
    about,
    integer,
)
from pickproof.scenarios.commands.invocation import command_line
from pickproof.scenarios.config.seeds import MAX_SEED

if TYPE_CHECKING:
    from pickproof.scenarios.results.records import AttemptRecord


@dataclass(frozen=True, kw_only=True)
class RunOptions(ScenarioFields):
    """Options of `pickproof run`."""

    workers: Annotated[
        int | None, integer(1, 256), about("worker processes; default: 1, or with --ray all of the cluster")
    ] = None
    episodes: Annotated[int, integer(1, 1_000_000), about("bin fills")] = 10
    seed: Seed = None
    out: Annotated[Path | None, FOLDER_TO_WRITE, about("default: out/SCENARIO-SEED")] = None
    resume: Annotated[bool, about("continue the campaign in --out")] = False
    ray: Annotated[
        str | None, about("run on a Ray cluster: HOST:PORT, auto, or local to start one on this machine")
    ] = None
    no_pictures: Annotated[bool, about("store no pictures of attempts")] = False
    keep: Annotated[Literal["failures", "all", "none"], about("attempts stored for `pickproof replay`")] = "failures"
    method: Annotated[
        Method | None, about("how poses are found: ps6d, search, both or auto; default: the scenario's")
    ] = None
    json: Annotated[bool, about("print the summary as JSON; progress goes to stderr")] = False


def run(
    scenario: ScenarioName,
    /,
    *,
    options: Annotated[RunOptions, Flat] = RunOptions(),
) -> int:
    """`pickproof run SCENARIO`."""
    from rich.console import Console

    from pickproof.scenarios.campaign.campaign import run_campaign
    from pickproof.scenarios.campaign.episode import run_episode
    from pickproof.scenarios.campaign.request import CampaignRequest
    from pickproof.scenarios.commands.pick.progress import CampaignProgress
    from pickproof.scenarios.config.scenario import load_scenario, weights_used
    from pickproof.scenarios.files.atomic import free_folder
    from pickproof.scenarios.picking.workcell import check_inputs
    from pickproof.scenarios.results.broken_campaign import check_ran
    from pickproof.scenarios.results.replay_selection import Keep
    from pickproof.scenarios.results.store import Store
    from pickproof.scenarios.results.summary import FILE, counted, print_summary, summarise, write_summary

    method = () if options.method is None else (f"perception.method={options.method}",)
    chosen = load_scenario(scenario, [*options.set, *method])
    seed = chosen.seed if options.seed is None else options.seed
    if seed + options.episodes - 1 > MAX_SEED:
        raise InputError("command line", "--seed", seed, f"at most {MAX_SEED} for the last episode")
    if options.resume and options.out is None:
        raise InputError("command line", "--resume", "no --out", "--out DIR with the results to continue")
    out = options.out or free_folder(Path("out") / f"{chosen.name}-{seed}")
    oracle = frozenset[str](options.oracle)
    check_inputs(chosen, oracle)
    console = Console(stderr=options.json)
    done = _ended(out) if options.resume else []
    if not options.json:
        console.print(
            f"{chosen.name}: {counted(options.episodes, 'episode')} of {counted(chosen.count, 'workpiece')}, "
            f"results in {out}",
            soft_wrap=True,
        )
    try:
        with CampaignProgress(console, options.episodes, chosen.count, done) as progress:
            request = CampaignRequest(
                scenario=chosen.model_copy(update={"seed": seed}),
                episodes=options.episodes,
                seed=seed,
                workers=options.workers or (0 if options.ray else 1),
                ray=options.ray,
                oracle=oracle,
                out=out,
                runner=run_episode,
                keep=Keep(out, options.keep),
                weights_hash=weights_used(chosen, oracle),
                command=command_line(),
                resume=options.resume,
                pictures=not options.no_pictures,
            )
            run_campaign(request, progress.update)
    except KeyboardInterrupt:
        with Store.read(out) as store:
            kept = len(store.attempts(large=False))
        print(
            f"pickproof: interrupted; {kept} attempts are kept in {out}; continue with --resume --out {out}",
            file=sys.stderr,
        )
        return 130
    with Store.read(out) as store:
        summary = summarise(store)
    write_summary(out, summary)
    if options.json:
        print(json.dumps(summary, indent=2))
    else:
        print_summary(console, summary)
        console.print(f"wrote {out / FILE}; for a page with pictures: pickproof report {out}", soft_wrap=True)
    check_ran(out)
    return 0


def _ended(out: Path) -> list[AttemptRecord]:
    """Number of attempts of the episodes that have ended."""
    from pickproof.scenarios.results.store import Store

    with Store.read(out) as store:
        ended = {e.seed for e in store.episodes()}
        return [a for a in store.attempts(large=False) if a.seed in ended]
