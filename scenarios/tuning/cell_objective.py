"""Campaigns of `pickproof tune`: candidates over the bins of the search, the old cell and the new over unseen ones."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pickproof.grasping.grasp_points import GraspPoint
from pickproof.scenarios.campaign.campaign import run_campaign
from pickproof.scenarios.campaign.executor import Runner
from pickproof.scenarios.campaign.request import CampaignRequest
from pickproof.scenarios.comparison.compare import Comparison, compare
from pickproof.scenarios.comparison.paired import Outcome, outcomes
from pickproof.scenarios.config.scenario import Scenario, scenario_json, weights_used
from pickproof.scenarios.files.atomic import free_folder, write_whole
from pickproof.scenarios.files.grasps_text import table_text
from pickproof.scenarios.results.store import FILE, Store
from pickproof.scenarios.tuning.cell_space import Cell
from pickproof.scenarios.tuning.plan import HOLDOUT, Deadline, Plan, Runners


def run_cell(plan: Plan, runner: Runner, cell: Cell, episodes: int) -> list[Outcome]:
    """The first episodes of a candidate; what its folder holds already is not run again."""
    key = hashlib.sha256(f"{_plain(cell.scenario)} {points_hash(cell.points)}".encode()).hexdigest()[:16]
    return run_folder(plan, runner, plan.out / "campaigns" / key, cell, Bins(plan.scenario.seed, episodes))


def points_hash(points: Sequence[GraspPoint]) -> str:
    """Of grasp points in their order."""
    return hashlib.sha256("\n".join(p.model_dump_json() for p in points).encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Bins:
    """Bins to be emptied: `episodes` of them, seeded from `seed` on."""

    seed: int
    episodes: int


def run_folder(plan: Plan, runner: Runner, folder: Path, cell: Cell, bins: Bins) -> list[Outcome]:
    """Episodes of a cell with its own grasp points, in order of seed; `folder` keeps them."""
    scenario, there = _prepared(plan, folder, cell, bins.seed)
    end = bins.seed + bins.episodes
    if not there or _ended(folder, end) < bins.episodes:
        request = CampaignRequest(
            scenario=scenario,
            episodes=max(bins.episodes, _asked(folder) if there else 0),
            seed=bins.seed,
            workers=plan.workers,
            ray=plan.ray,
            oracle=plan.oracle,
            out=folder,
            runner=runner,
            weights_hash=weights_used(scenario, plan.oracle),
            command=plan.command,
            resume=there,
            pictures=False,
        )
        run_campaign(request)
    with Store.read(folder) as store:
        found = outcomes(store.attempts(large=False), store.episodes())
    return sorted((o for o in found if o.seed < end), key=lambda o: o.seed)


def _prepared(plan: Plan, folder: Path, cell: Cell, seed: int) -> tuple[Scenario, bool]:
    """The scenario that reads the grasp points written to `folder`, and whether results of the cell are there.

    Results of another cell, which an earlier end of the search proposed, are moved out of the way.
    """
    own, text = folder / "grasps.yaml", table_text(cell.points, plan.gripper)
    scenario = cell.scenario.model_copy(update={"grasps": str(own.resolve()), "seed": seed})
    there = (folder / FILE).is_file()
    if there and (own.read_text(encoding="utf-8") != text or _scenario_of(folder) != _plain(scenario)):
        folder.rename(free_folder(folder))
        there = False
    if not there:
        write_whole(own, text)
    return scenario, there


def on_unseen_bins(plan: Plan, runners: Runners, cell: Cell, go_on: Deadline) -> Comparison:
    """The cell as it was and the proposed one over bins that the search has not seen, as many as the budget lets."""
    seed = plan.scenario.seed + HOLDOUT
    sides = {"old": Cell(list(plan.points), plan.scenario), "new": cell}
    for n in [*range(plan.block, plan.holdout, plan.block), plan.holdout]:
        for name, side in sides.items():
            run_folder(plan, runners.episode, plan.out / name, side, Bins(seed, n))
        runners.tell("unseen bins", n, plan.holdout)
        if n >= 2 and not go_on():
            break
    return compare(plan.out / "old", plan.out / "new")


def _ended(folder: Path, before: int) -> int:
    """How many episodes of seeds below `before` have ended; of workers' episodes a later one may end first."""
    with Store.read(folder) as store:
        return sum(e.seed < before for e in store.episodes())


def _scenario_of(folder: Path) -> str:
    with Store.read(folder) as store:
        return _plain(Scenario.model_validate_json(store.meta()["scenario"]))


def _plain(scenario: Scenario) -> str:
    """The scenario without its seed and where its table lies."""
    return scenario_json(scenario.model_copy(update={"seed": 0, "grasps": ""}))


def _asked(folder: Path) -> int:
    with Store.read(folder) as store:
        return int(store.meta()["episodes"])
