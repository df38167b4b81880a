"""The second stage of `pickproof tune`: tables, priorities, weights and fields in campaigns over the same bins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from optuna.storages import JournalStorage

from pickproof.scenarios.comparison.paired import Outcome
from pickproof.scenarios.tuning.cell_objective import points_hash, run_cell
from pickproof.scenarios.tuning.cell_space import PRIORITY, TABLE, candidate, cell_parameters
from pickproof.scenarios.tuning.grasp_stage import TunedGrasps
from pickproof.scenarios.tuning.optimizer import Search, Told, Trial, Values, run_searches
from pickproof.scenarios.tuning.plan import Deadline, Plan, Runners
from pickproof.scenarios.tuning.racing import Finish, race

PER_ROUND = 4
"""Cells of a round; fixed, so that the outcome is the same for any number of workers."""
NORMAL95 = 1.96
SHRINK_EPISODES = 2  # without any gain, that every candidate is taken to have run before
CELL = "cell"


def tune_cell(plan: Plan, journal: JournalStorage, runners: Runners, grasps: TunedGrasps, go_on: Deadline) -> Search:
    """The second stage: tables, priorities, weights and fields in campaigns over the same bins."""
    points = [p for p in plan.points if p.name in plan.names]
    any_moved = any(c.changed for c in grasps.changes)
    parameters = cell_parameters(points, plan.scenario, plan.fields, any_moved)
    start = {p.name: p.start for p in parameters}
    shares = {PRIORITY + c.name: c.share[1] for c in grasps.changes}
    given = [start | {TABLE: 1}, start | {TABLE: 1} | shares] if any_moved else [start | shares] if shares else []
    # with more generations of the grasps the moved table is another one, and what is known of the old one is not used
    search = Search(journal, f"{CELL} {points_hash(grasps.points)}", parameters, plan.scenario.seed, given)
    done = 0

    def outcomes_of(key: tuple[tuple[str, float], ...], n: int) -> list[Outcome]:
        nonlocal done
        cell = candidate(dict(key), (plan.points, grasps.points), plan.scenario)
        found = run_cell(plan, runners.episode, cell, n)
        done += 1
        runners.tell("blocks of bins, this round", done, 0)
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


def winner(search: Search) -> Trial | None:
    """The cell to be proposed, None where none is above the start.

    A cell that was given, the moved table with one set of priorities or the other, is taken before one whose weights
    were drawn, unless that is better by more than one standard error: of some cells over a few bins the best one is
    mostly the luckiest (the one-standard-error rule, Breiman et al. 1984).
    """

    def best_of(trials: Sequence[Trial]) -> Trial | None:
        able = [t for t in trials if not t.detail["dropped"] and t.value > 0]
        return max(able, key=lambda t: (t.value, -t.number), default=None)

    best, given = best_of(search.trials), best_of(search.trials[: search.given])
    if best is None or given is None:
        return best
    low, high = best.detail["interval95"]
    return given if given.value >= best.value - (high - low) / (2 * NORMAL95) else best


def _told(finish: Finish) -> Told:
    """The gain, less the fewer bins it was seen in: the luckiest of many short races would win otherwise."""
    detail = asdict(finish) | {"interval95": list(finish.interval95)}
    return Told(finish.gain * finish.episodes / (finish.episodes + SHRINK_EPISODES), detail)
