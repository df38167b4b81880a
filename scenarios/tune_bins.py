"""Campaigns of `pickproof tune`: candidates over the bins of the search, the old cell and the new over unseen ones."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from grasping.grasp_points import GraspPoint, read_table
from scenarios.campaign import run_campaign
from scenarios.compare import Comparison, compare
from scenarios.files import write_whole
from scenarios.grasps import table_text
from scenarios.paired import Outcome, outcomes
from scenarios.pool import Runner
from scenarios.scenario import Scenario, scenario_json, weights_used
from scenarios.store import FILE, Store
from scenarios.tune_plan import HOLDOUT, Plan, Tell


def run_cell(
    plan: Plan, runner: Runner, points: Sequence[GraspPoint], scenario: Scenario, episodes: int
) -> list[Outcome]:
    """The first episodes of a candidate; what its folder holds already is not run again."""
    plain = scenario_json(scenario.model_copy(update={"seed": 0, "grasps": ""}))
    key = hashlib.sha256(f"{plain} {points_hash(points)}".encode()).hexdigest()[:16]
    return run_folder(plan, runner, plan.out / "campaigns" / key, points, scenario, plan.scenario.seed, episodes)


def points_hash(points: Sequence[GraspPoint]) -> str:
    """Of grasp points in their order."""
    return hashlib.sha256("\n".join(p.model_dump_json() for p in points).encode()).hexdigest()[:16]


def run_folder(
    plan: Plan,
    runner: Runner,
    folder: Path,
    points: Sequence[GraspPoint],
    scenario: Scenario,
    seed: int,
    episodes: int,
) -> list[Outcome]:
    """Episodes from `seed` on with grasp points of their own, in order of seed."""
    own = folder / "grasps.yaml"
    if not own.is_file():
        write_whole(own, table_text(list(points), read_table(plan.table).gripper))
    scenario = scenario.model_copy(update={"grasps": str(own.resolve()), "seed": seed})
    there = (folder / FILE).is_file()
    if not there or _ended(folder) < episodes:
        run_campaign(
            scenario,
            episodes=max(episodes, _asked(folder) if there else 0),
            seed=seed,
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
    with Store.read(folder) as store:
        found = outcomes(store.attempts(large=False), store.episodes())
    return sorted((o for o in found if o.seed < seed + episodes), key=lambda o: o.seed)


def on_unseen_bins(
    plan: Plan,
    runner: Runner,
    points: Sequence[GraspPoint],
    scenario: Scenario,
    tell: Tell,
    go_on: Callable[[], bool],
) -> Comparison:
    """Both over bins that the search has not seen, as many as the budget lets."""
    seed = plan.scenario.seed + HOLDOUT
    sides: Iterable[tuple[str, Sequence[GraspPoint], Scenario]] = (
        ("old", plan.points, plan.scenario),
        ("new", points, scenario),
    )
    for n in [*range(plan.block, plan.holdout, plan.block), plan.holdout]:
        for name, own, cell in sides:
            run_folder(plan, runner, plan.out / name, own, cell, seed, n)
        tell("unseen bins", n, plan.holdout)
        if n >= 2 and not go_on():
            break
    return compare(plan.out / "old", plan.out / "new")


def _ended(folder: Path) -> int:
    with Store.read(folder) as store:
        return len(store.episodes())


def _asked(folder: Path) -> int:
    with Store.read(folder) as store:
        return int(store.meta()["episodes"])
