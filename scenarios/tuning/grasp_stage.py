"""The first stage of `pickproof tune`: each grasp by itself, and the table with those moved that gain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from optuna.storages import JournalStorage

from pickproof.cell.frames import Array
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.grasp_points import GraspPoint
from pickproof.scenarios.tuning.grasp_objective import GraspTask, draw_errors
from pickproof.scenarios.tuning.grasp_space import distance, grasp_parameters, moved
from pickproof.scenarios.tuning.optimizer import Search, Told, Trial, Values, run_searches
from pickproof.scenarios.tuning.plan import Deadline, Plan, Runners

PER_GRASP = 6
"""Trials in a generation of each grasp; fixed, so that the outcome is the same for any number of workers."""
FINALISTS = 4
"""Best trials of a search that are tried again under other errors."""
WORTH = 0.05
"""Gain on the lone workpiece below which a grasp point stays as it is."""


@dataclass(frozen=True)
class GraspChange:
    """One grasp before and after: value of the search, and share held under errors that the search had not seen."""

    name: str
    changed: bool
    value: tuple[float, float]
    share: tuple[float, float]
    reason: tuple[str, str]


def tune_grasps(plan: Plan, journal: JournalStorage, runners: Runners, go_on: Deadline) -> dict[str, Search]:
    """The first stage: each grasp by itself on a lone workpiece, under the same errors of the pose in every trial."""
    gripper = load_gripper(plan.scenario.gripper)
    points = {p.name: p for p in plan.points if p.name in plan.names}
    searches = {
        name: Search(journal, f"grasp {name}", grasp_parameters(point, gripper, plan.reach), plan.scenario.seed)
        for name, point in points.items()
    }
    errors = _errors(plan, 0)

    def evaluate(asked: list[tuple[str, Values]]) -> list[Told]:
        tasks = [
            _task(plan, moved(points[name], values), errors, distance(searches[name].parameters, values))
            for name, values in asked
        ]
        told = []
        for result in runners.map(runners.trial, tasks):
            told.append(result)
            runners.tell("trials of grasps, this generation", len(told), len(tasks))
        return told

    run_searches(searches, evaluate, PER_GRASP, plan.generations, go_on)
    return searches


@dataclass(frozen=True)
class TunedGrasps:
    """What the first stage found: of each grasp that was tuned its change, and the table with those moved that gain."""

    changes: list[GraspChange]
    points: list[GraspPoint]


def settle(plan: Plan, searches: dict[str, Search], runners: Runners) -> TunedGrasps:
    """Try every grasp before and after under unseen errors, and move those in the table that are worth it."""
    unseen = _errors(plan, 2)
    old = {p.name: p for p in plan.points if p.name in searches}
    new = _finals(plan, searches, old, runners)
    tasks = [_task(plan, point, unseen) for point in old.values()]
    tasks += [_task(plan, moved(old[name], best.values), unseen) for name, best in new.items()]
    told = list(runners.map(runners.trial, tasks))
    was, now = dict(zip(old, told, strict=False)), dict(zip(new, told[len(old) :], strict=True))
    changes = []
    for name, search in searches.items():
        value = next((t.value for t in search.trials if t.number == 0), float("nan"))
        after = now.get(name, was[name])
        changes.append(
            GraspChange(
                name,
                name in new,
                (value, new[name].value if name in new else value),
                (was[name].detail["share"], after.detail["share"]),
                (was[name].detail["reason"], after.detail["reason"]),
            )
        )
    return TunedGrasps(changes, [moved(p, new[p.name].values) if p.name in new else p for p in plan.points])


def _finals(plan: Plan, searches: dict[str, Search], old: dict[str, GraspPoint], runners: Runners) -> dict[str, Trial]:
    """Of each search the best of its FINALISTS under other errors too, where it beats the start by WORTH.

    The best of a hundred trials under seven errors is the one that suits these seven.
    """
    errors = _errors(plan, 1)
    heats: list[tuple[str, Trial]] = []
    for name, search in searches.items():
        start = next((t for t in search.trials if t.number == 0), None)
        if start is not None:
            better = [t for t in search.trials if t.value >= start.value + WORTH]
            heats += [(name, t) for t in (start, *sorted(better, key=lambda t: (-t.value, t.number))[:FINALISTS])]
    tasks = [
        _task(plan, moved(old[name], t.values), errors, distance(searches[name].parameters, t.values))
        for name, t in heats
    ]
    means: dict[str, list[tuple[float, Trial]]] = {}
    for (name, t), told in zip(heats, runners.map(runners.trial, tasks), strict=True):
        means.setdefault(name, []).append(((t.value + told.value) / 2, t))
    best = {name: max(rows, key=lambda row: (row[0], -row[1].number)) for name, rows in means.items()}
    return {name: t for name, (mean, t) in best.items() if mean >= means[name][0][0] + WORTH}


def _errors(plan: Plan, draw: int) -> Array:
    rng = np.random.default_rng((plan.scenario.seed, draw))
    return draw_errors(rng, load_workpiece(plan.scenario.workpiece), plan.p95)


def _task(plan: Plan, point: GraspPoint, errors: Array, far: float = 0.0) -> GraspTask:
    return GraspTask(plan.scenario.workpiece, plan.scenario.gripper, point, errors, far)
