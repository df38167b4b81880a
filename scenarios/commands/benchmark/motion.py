"""`pickproof benchmark motion`: cycle times of planned picks beside their lower bound."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.arguments import JsonFile, about, integer

if TYPE_CHECKING:
    from pickproof.scenarios.config.scenario import Scenario


def motion(
    scenario: Annotated[str, about("a name that `pickproof list` shows, or a YAML file")] = "bracket",
    /,
    *,
    picks: Annotated[int, integer(2, 10_000), about("number of planned picks")] = 42,
    json: JsonFile = None,
) -> int:
    """`pickproof benchmark motion`."""
    from pickproof.scenarios.campaign.motion_times import measure, summary
    from pickproof.scenarios.config.scenario import load_scenario
    from pickproof.scenarios.files.atomic import write_json

    chosen = load_scenario(scenario)
    measured = list(measure(chosen, picks))
    if not any(m.steady for m in measured):
        raise InputError(
            "command line", "SCENARIO", scenario, "a scenario whose workpieces can be picked one after another"
        )
    figures = summary(measured)
    if json is not None:
        write_json(json, figures)
    _show(figures, chosen)
    return 0


def _show(figures: dict[str, Any], scenario: Scenario) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"motion: {figures['picks']} picks of {scenario.name}, {scenario.robot}", show_header=False)
    cycle, plan, stopping = figures["cycle_s"], figures["plan_ms"], figures["stop_at_each_s"]
    rows = (
        ("robot time of a cycle", f"{cycle['mean']:.2f} s mean, {cycle['p95']:.2f} s p95"),
        ("  motion + jaws", f"{figures['motion_s']:.2f} s + {figures['jaws_s']:.2f} s"),
        ("lower bound of the cycle", f"{figures['bound_s']:.2f} s, ratio {figures['cycle_over_bound']:.2f}"),
        ("  of the motion alone", f"ratio {figures['motion_over_bound']:.2f}"),
        ("stopping at every point", "-" if stopping is None else f"{stopping:.2f} s"),
        ("inverse kinematics, all branches", f"{figures['ik_us']:.1f} us a pose"),
        ("collision check", f"{figures['collision_us']:.0f} us"),
        ("planning of a whole pick", f"{plan['median']:.0f} ms median, {plan['p99']:.0f} ms p99"),
    )
    for row in rows:
        table.add_row(*row)
    Console().print(table)
