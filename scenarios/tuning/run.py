"""`pickproof tune` from its plan to its result: grasps, whole cells, and the unseen bins, which decide."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from optuna.storages import JournalStorage

from pickproof.grasping.grasp_points import GraspPoint
from pickproof.scenarios.comparison.compare import Comparison
from pickproof.scenarios.comparison.paired import changed_fields
from pickproof.scenarios.config.scenario import Scenario
from pickproof.scenarios.tuning.cell_objective import on_unseen_bins
from pickproof.scenarios.tuning.cell_space import Cell, candidate
from pickproof.scenarios.tuning.cell_stage import CELL, tune_cell, winner
from pickproof.scenarios.tuning.grasp_stage import GraspChange, settle, tune_grasps
from pickproof.scenarios.tuning.optimizer import Trial
from pickproof.scenarios.tuning.plan import Deadline, Plan, Runners

STAGES = (0.3, 0.7)  # of the budget, at which the grasps and the campaigns end


@dataclass(frozen=True)
class Result:
    """What was found.

    Attributes:
        points, scenario: proposed; fields: dotted fields of the scenario that changed, with their new values.
        grasps: of each grasp that was tuned; cells: the trials of whole cells, with how each left its race.
        importances: by search, share of each parameter in what sets the best apart.
        history: by search, its trials.
        comparison: over unseen bins, None where nothing better was found.
    """

    points: list[GraspPoint]
    scenario: Scenario
    fields: dict[str, Any]
    grasps: list[GraspChange]
    history: dict[str, list[Trial]]
    importances: dict[str, dict[str, float]]
    comparison: Comparison | None


def run_plan(plan: Plan, journal: JournalStorage, runners: Runners) -> Result:
    """Move the grasps, race whole cells, compare the winner with what there was; goes on where the journal ends."""
    begun = time.monotonic()

    def before(share: float) -> Deadline:
        return lambda: plan.budget_s is None or time.monotonic() - begun < share * plan.budget_s

    searches = tune_grasps(plan, journal, runners, before(STAGES[0]))
    grasps = settle(plan, searches, runners)
    cells = tune_cell(plan, journal, runners, grasps, before(STAGES[1]))
    best = winner(cells)
    proposed = Cell(list(plan.points), plan.scenario)
    if best is not None:
        proposed = candidate(best.values, (plan.points, grasps.points), plan.scenario)
    comparison = None
    if best is not None and best.values:
        comparison = on_unseen_bins(plan, runners, proposed, before(1.0))
    everything = searches | {CELL: cells}
    return Result(
        points=proposed.points,
        scenario=proposed.scenario,
        fields=_changed(plan.scenario, proposed.scenario),
        grasps=grasps.changes,
        history={name: s.trials for name, s in everything.items()},
        importances={name: s.importances() for name, s in everything.items()},
        comparison=comparison,
    )


def _changed(before: Scenario, after: Scenario) -> dict[str, Any]:
    """Dotted fields that differ, lists element by element, with their new values."""
    found: dict[str, Any] = {}
    a, b = before.model_dump(mode="json"), after.model_dump(mode="json")
    for name in changed_fields(a, b):
        old, new = a, b
        for key in name.split("."):
            old, new = old[key], new[key]
        if isinstance(new, list):
            found |= {f"{name}.{i}": y for i, (x, y) in enumerate(zip(old, new, strict=True)) if x != y}
        else:
            found[name] = new
    return found
