"""Four campaigns over the same bins, each with other stages replaced by ground truth, and what they show."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pickproof.scenarios.campaign.job import Runner
from pickproof.scenarios.comparison.attribution import MODES, Attribution, attribute, plot_attribution, verdict_line
from pickproof.scenarios.comparison.paired import outcomes
from pickproof.scenarios.comparison.sweep import Point, run_point
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.files.atomic import write_json
from pickproof.scenarios.results.store import FILE, Store


def folder_of(mode: tuple[str, ...]) -> str:
    """Name of the folder of a campaign in which these stages are replaced."""
    return "+".join(mode) or "nothing"


def run_modes(
    scenario: Scenario,
    episodes: int,
    workers: int,
    out: Path,
    runner: Runner,
    command: str,
    say: Callable[[str], None] = lambda text: None,
) -> Attribution:
    """Run, or continue, one campaign for each of MODES over the same bins, and compare them.

    Leaves a results file and a summary in a folder of `out` each, and there `attribution.json` and `attribution.png`.
    """
    summaries: list[dict[str, Any]] = []
    known, folders = [], []
    for mode in MODES:
        folder = out / folder_of(mode)
        say(f"{len(summaries) + 1} of {len(MODES)}: replaced by ground truth: {folder_of(mode)}")
        summaries.append(
            run_point(Point((), scenario, folder), episodes, workers, frozenset(mode), runner, command, {})
        )
        with Store.read(folder) as store:
            attempts = store.attempts(large=False)
            known.append(outcomes(attempts, store.episodes()))
        folders.append(folder / FILE)
    result = attribute(known, summaries, folders, Counter(a.grasp for a in attempts if a.moved and not a.success))
    write_json(out / "attribution.json", as_document(result, command))
    plot_attribution(result, out / "attribution.png")
    return result


def as_document(a: Attribution, command: str) -> dict[str, Any]:
    """The attribution as JSON."""
    modes = [
        {"replaced": list(mode), "folder": folder_of(mode), "summary": s}
        for mode, s in zip(MODES, a.summaries, strict=True)
    ]
    return {
        "episodes": a.episodes,
        "named": a.named,
        "basis": a.basis,
        "verdict": verdict_line(a),
        "rest": a.rest,
        "rest_points_at": a.rest_points_at,
        "rest_by_grasp": a.rest_by_grasp,
        "stages": [asdict(s) for s in a.stages],
        "modes": modes,
        "command": command,
    }
