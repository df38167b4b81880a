"""`pickproof benchmark campaign`: attempts per hour and core, time by stage, overhead of engine and workers."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pickproof.scenarios.commands.arguments import JsonFile, about, integer

if TYPE_CHECKING:
    from pickproof.scenarios.config.scenario import Scenario


def campaign(
    scenario: Annotated[str, about("a name that `pickproof list` shows, or a YAML file")] = "bracket",
    /,
    *,
    episodes: Annotated[int, integer(2, 1000), about("bins with one and with two workers")] = 4,
    set: Annotated[tuple[str, ...], about("FIELD=VALUE overrides a field")] = (),
    json: JsonFile = None,
) -> int:
    """`pickproof benchmark campaign`."""
    from pickproof.scenarios.campaign.speed import measure
    from pickproof.scenarios.config.scenario import load_scenario
    from pickproof.scenarios.files.atomic import write_json

    chosen = load_scenario(scenario, list(set))
    with tempfile.TemporaryDirectory() as folder:
        figures = measure(chosen, episodes, Path(folder))
    if json is not None:
        write_json(json, figures)
    _show(figures, chosen)
    return 0


def _show(figures: dict[str, Any], scenario: Scenario) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"campaigns of {scenario.name}", show_header=False)
    hourly = figures["picks_per_hour_core"]
    table.add_row("attempts per hour and core, perfect poses", f"{hourly['oracle']:.0f}")
    table.add_row("attempts per hour and core, PS6D", f"{hourly['ps6d']:.0f}")
    table.add_row("two workers over one, wall time", f"{figures['two_worker_speedup']:.2f}")
    table.add_row("  processor time", f"{figures['two_worker_speedup_processor']:.2f}")
    table.add_row("campaign engine over a plain loop", f"{100 * figures['engine_overhead']:.2f} %")
    for name, seconds in figures["split_s"].items():
        table.add_row(f"  {name}", f"{seconds:.3f} s per attempt")
    table.add_row("processors busy with other work", f"{figures['elsewhere']:.2f}")
    Console().print(table)
