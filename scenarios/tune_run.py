"""The two stages of `pickproof tune`, and the bins that nobody has seen which decide."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from optuna.storages import JournalStorage

from cell.frames import Array
from cell.gripper import load_gripper
from grasping.grasp_points import GraspPoint, read_table
from scenarios.campaign import run_campaign
from scenarios.compare import Comparison, compare
from scenarios.files import write_whole
from scenarios.grasps import table_text
from scenarios.paired import Outcome, changed_fields, outcomes
from scenarios.parallel import Map
from scenarios.pool import Runner
from scenarios.scenario import Scenario, scenario_json, weights_used
from scenarios.store import FILE, Store
from scenarios.tune_race import Finish, race
from scenarios.tune_search import Search, Told, Trial, Values, run_searches
from scenarios.tune_space import (
    PRIORITY,
    TABLE,
    Field,
    Reach,
    candidate,
    cell_parameters,
    distance,
    grasp_parameters,
    moved,
)
from scenarios.tune_trial import GraspTask, draw_errors, try_point

HOLDOUT = 1_000_000
"""Added to the seed for the bins of the final comparison, which the search never sees."""
PER_GRASP, PER_ROUND = 6, 4
"""Trials of a generation: of each grasp, and of whole cells. Fixed, so that the outcome is the same for any workers."""
WORTH = 0.05
"""Gain on the lone workpiece below which a grasp point stays as it is."""
STAGES = (0.3, 0.7)  # of the budget, at which the grasps and the campaigns end
SHRINK_EPISODES = 2  # without any gain, that every candidate is taken to have run before
CELL = "cell"
Tell = Callable[[str, int, int], None]
"""Called as the work goes on: stage, done, of how many (0 where that is not known)."""


@dataclass(frozen=True)
class Plan:
    """What is tuned, and with how much effort.

    Attributes:
        scenario: as it is, with the seed of bins and search; `points` are those of its `table`, `names` those of them
            that may be moved, `reach` how far.
        fields: numbers of the scenario that may change too.
        generations: of each grasp; rounds: of whole cells; episodes: of a candidate at most, `block` at a time.
        holdout: unseen episodes of the final comparison.
        p95: errors of perception by direction, None for a default.
        budget_s: [s] after which stages end early, None for no limit.
    """

    scenario: Scenario
    table: Path
    points: tuple[GraspPoint, ...]
    names: tuple[str, ...]
    fields: tuple[Field, ...]
    oracle: frozenset[str]
    out: Path
    reach: Reach
    generations: int = 8
    rounds: int = 4
    episodes: int = 8
    block: int = 2
    holdout: int = 20
    p95: dict[str, float] | None = None
    budget_s: float | None = None
    workers: int = 1
    ray: str | None = None
    command: str = ""


@dataclass(frozen=True)
class GraspChange:
    """One grasp before and after: value of the search, and share held under errors that the search had not seen."""

    name: str
    changed: bool
    value: tuple[float, float]
    share: tuple[float, float]
    reason: tuple[str, str]


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


def run_plan(
    plan: Plan,
    journal: JournalStorage,
    run: Map,
    runner: Runner,
    tell: Tell = lambda stage, done, total: None,
    trial: Callable[[GraspTask], Told] = try_point,
) -> Result:
    """Move the grasps, race whole cells, compare the winner with what there was; goes on where the journal ends.

    Args:
        run: as the built-in `map`, over the trials of a generation.
        runner: runs an episode; trial: tries a grasp.
    """
    begun = time.monotonic()

    def before(share: float) -> Callable[[], bool]:
        return lambda: plan.budget_s is None or time.monotonic() - begun < share * plan.budget_s

    searches = tune_grasps(plan, journal, run, tell, trial, before(STAGES[0]))
    changes, tuned = _settled(plan, searches, run, trial)
    cells = tune_cell(plan, journal, runner, tuned, changes, tell, before(STAGES[1]))
    best = max((t for t in cells.trials if not t.detail["dropped"]), key=lambda t: (t.value, -t.number), default=None)
    points, scenario, values = list(plan.points), plan.scenario, {}
    if best is not None and best.value > 0:
        values = best.values
        points, scenario = candidate(values, (plan.points, tuned), plan.scenario)
    comparison = None
    if values:
        comparison = _on_unseen_bins(plan, runner, points, scenario, tell, before(1.0))
    everything = searches | {CELL: cells}
    return Result(
        points=points,
        scenario=scenario,
        fields=_changed(plan.scenario, scenario),
        grasps=changes,
        history={name: s.trials for name, s in everything.items()},
        importances={name: s.importances() for name, s in everything.items()},
        comparison=comparison,
    )


def tune_grasps(
    plan: Plan,
    journal: JournalStorage,
    run: Map,
    tell: Tell,
    trial: Callable[[GraspTask], Told],
    go_on: Callable[[], bool],
) -> dict[str, Search]:
    """The first stage: each grasp by itself on a lone workpiece, under the same errors of the pose in every trial."""
    gripper = load_gripper(plan.scenario.gripper)
    points = {p.name: p for p in plan.points if p.name in plan.names}
    searches = {
        name: Search(journal, f"grasp {name}", grasp_parameters(point, gripper, plan.reach), plan.scenario.seed)
        for name, point in points.items()
    }
    errors = draw_errors(np.random.default_rng((plan.scenario.seed, 0)), plan.p95)

    def evaluate(asked: list[tuple[str, Values]]) -> list[Told]:
        tasks = [
            _task(plan, moved(points[name], values), errors, distance(searches[name].parameters, values))
            for name, values in asked
        ]
        told = []
        for result in run(trial, tasks):
            told.append(result)
            tell("trials of grasps, this generation", len(told), len(tasks))
        return told

    run_searches(searches, evaluate, PER_GRASP, plan.generations, go_on)
    return searches


def _settled(
    plan: Plan, searches: dict[str, Search], run: Map, trial: Callable[[GraspTask], Told]
) -> tuple[list[GraspChange], list[GraspPoint]]:
    """Before and after of every grasp under new errors, and the table with those moved that are worth it."""
    errors = draw_errors(np.random.default_rng((plan.scenario.seed, 1)), plan.p95)
    new = {}
    for name, search in searches.items():
        best, start = search.best, next((t for t in search.trials if t.number == 0), None)
        if best is not None and start is not None and best.value >= start.value + WORTH:
            new[name] = best
    old = {p.name: p for p in plan.points if p.name in searches}
    tasks = [_task(plan, point, errors) for point in old.values()]
    tasks += [_task(plan, moved(old[name], best.values), errors) for name, best in new.items()]
    told = list(run(trial, tasks))
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
    return changes, [moved(p, new[p.name].values) if p.name in new else p for p in plan.points]


def _task(plan: Plan, point: GraspPoint, errors: Array, far: float = 0.0) -> GraspTask:
    return GraspTask(plan.scenario.workpiece, plan.scenario.gripper, point, errors, far)


def tune_cell(
    plan: Plan,
    journal: JournalStorage,
    runner: Runner,
    tuned: Sequence[GraspPoint],
    changes: Sequence[GraspChange],
    tell: Tell,
    go_on: Callable[[], bool],
) -> Search:
    """The second stage: tables, priorities, weights and fields in campaigns over the same bins."""
    points = [p for p in plan.points if p.name in plan.names]
    any_moved = any(c.changed for c in changes)
    parameters = cell_parameters(points, plan.scenario, plan.fields, any_moved)
    start = {p.name: p.start for p in parameters}
    shares = {PRIORITY + c.name: c.share[1] for c in changes}
    given = [start | {TABLE: 1}, start | {TABLE: 1} | shares] if any_moved else [start | shares] if shares else []
    # with more generations of the grasps the moved table is another one, and what is known of the old one is not used
    search = Search(journal, f"{CELL} {_points_hash(tuned)}", parameters, plan.scenario.seed, given)
    done = 0

    def outcomes_of(key: tuple[tuple[str, float], ...], n: int) -> list[Outcome]:
        nonlocal done
        own_points, scenario = candidate(dict(key), (plan.points, tuned), plan.scenario)
        found = run_cell(plan, runner, own_points, scenario, n)
        done += 1
        tell("blocks of bins, this round", done, 0)
        return found

    def evaluate(asked: list[tuple[str, Values]]) -> list[Told]:
        nonlocal done
        done = 0
        keys = [tuple(sorted(values.items())) for _, values in asked]
        finished = race(keys, tuple(sorted(start.items())), outcomes_of, plan.block, plan.episodes, go_on)
        return [_told(finished[key]) for key in keys]

    if parameters:
        run_searches({CELL: search}, evaluate, PER_ROUND, plan.rounds, go_on)
    return search


def _told(finish: Finish) -> Told:
    """The gain, less the fewer bins it was seen in: the luckiest of many short races would win otherwise."""
    detail = asdict(finish) | {"interval95": list(finish.interval95)}
    return Told(finish.gain * finish.episodes / (finish.episodes + SHRINK_EPISODES), detail)


def run_cell(
    plan: Plan, runner: Runner, points: Sequence[GraspPoint], scenario: Scenario, episodes: int
) -> list[Outcome]:
    """The first episodes of a candidate; what its folder holds already is not run again."""
    plain = scenario_json(scenario.model_copy(update={"seed": 0, "grasps": ""}))
    key = hashlib.sha256(f"{plain} {_points_hash(points)}".encode()).hexdigest()[:16]
    return run_folder(plan, runner, plan.out / "campaigns" / key, points, scenario, plan.scenario.seed, episodes)


def _points_hash(points: Sequence[GraspPoint]) -> str:
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


def _ended(folder: Path) -> int:
    with Store.read(folder) as store:
        return len(store.episodes())


def _asked(folder: Path) -> int:
    with Store.read(folder) as store:
        return int(store.meta()["episodes"])


def _on_unseen_bins(
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
