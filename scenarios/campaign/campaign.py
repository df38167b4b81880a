"""The campaign: episodes of one scenario at seeds s, s + 1, ... in a pool, one writer in the driver.

An episode depends on its scenario, the files that it names, and its seed alone: the record hash is the same for any
number of workers, here or on a cluster, interrupted or not.
"""

from __future__ import annotations

import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pickproof.cell.errors import InputError
from pickproof.cell.numerics import check_processor
from pickproof.scenarios.campaign.executor import STALL_S, Event, Failure, Kind, Pool, Task
from pickproof.scenarios.campaign.job import Job, Runner
from pickproof.scenarios.config.input_hashes import changed, input_hashes, inputs_hash, versions
from pickproof.scenarios.config.provenance import provenance
from pickproof.scenarios.config.scenario import Scenario, scenario_hash, scenario_json
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord, Reason
from pickproof.scenarios.results.replay_selection import Keep
from pickproof.scenarios.results.store import Store

RETRIES: dict[Kind, int] = {"broken": 0, "crashed": 1, "killed": 9}
"""How often an episode is run again after each kind of failure; a kill from outside says nothing about the episode."""


def run_campaign(
    scenario: Scenario,
    *,
    episodes: int,
    seed: int,
    workers: int,
    oracle: frozenset[str],
    out: Path,
    runner: Runner,
    weights_hash: str = "",
    command: str = "",
    resume: bool = False,
    pictures: bool = True,
    keep: Keep | None = None,
    on_event: Callable[[Event], None] = lambda event: None,
    stall_s: float = STALL_S,
    expected_s: Mapping[int, float] | None = None,
    ray: str | None = None,
) -> None:
    """Run the episodes that `out` does not hold yet and commit every attempt as it ends.

    Args:
        workers: episodes at a time; with `ray`, 0 for all processors of the cluster.
        oracle: stages replaced by ground truth.
        runner: runs one episode; it is sent to the workers by its import path.
        command: the command line, for the report.
        keep: which attempts are kept to look at again; None for none.
        on_event: called in the driver after each commit.
        stall_s: [s] without a word from an episode after which it counts as hung.
        expected_s: seed -> time that its episode takes, where known: the longest are begun first.
        ray: address of a Ray cluster, or `local` to start one here; None for worker processes.

    Raises:
        InputError: `out` holds results and `resume` is off, or they are of another campaign; or there is no such
            cluster; or this processor lacks what the numeric profile needs.
        StoreError: the results cannot be written any more; what was committed can be resumed.
        KeyboardInterrupt: Ctrl-C or SIGTERM; what had ended is committed.
    """
    check_processor()
    inputs = input_hashes(scenario, oracle)
    identity = {
        "scenario_hash": scenario_hash(scenario),
        "seed": seed,
        "oracle": sorted(oracle),
        "weights_hash": weights_hash,
        "inputs": inputs,
        "versions": versions(),
    }
    told = {"scenario": scenario_json(scenario), "episodes": episodes, "command": command, "wall_s": 0.0}
    told |= provenance()
    begun = time.perf_counter()
    task = Task(runner, Job(scenario, seed, oracle, pictures, keep), identity, stall_s)
    with (
        _signals_noted() as interrupted,
        _pool(task, workers, interrupted, ray) as pool,
        Store.resume(out)
        if resume
        else Store.create(out, identity | told | {"inputs_hash": inputs_hash(inputs)}) as store,
    ):
        if resume:
            _check_same(store, identity, episodes, out)
        wall_before = float(store.meta()["wall_s"])
        store.set_meta({"command": command, "episodes": episodes})
        store.forget_unfinished()
        done = {e.seed for e in store.episodes()}
        todo = _longest_first([s for s in range(seed, seed + episodes) if s not in done], expected_s or {})
        try:
            for event in _attempted(pool, todo, scenario, store):
                on_event(event)
        finally:
            for event in pool.stop():
                _commit(store, event)
            store.set_meta({"wall_s": wall_before + time.perf_counter() - begun})


@contextmanager
def _pool(task: Task, workers: int, interrupted: Callable[[], bool], ray: str | None) -> Iterator[Pool]:
    if ray is None:
        from pickproof.scenarios.campaign.process_pool import Workers

        yield Workers(task, workers, interrupted)
    else:
        from pickproof.scenarios.campaign.ray_pool import connected

        with connected(ray, workers, task, interrupted) as pool:
            yield pool


def _longest_first(seeds: Sequence[int], expected_s: Mapping[int, float]) -> list[int]:
    """Those of unknown length count as average; equally long ones stay in order of seed."""
    known = [expected_s[s] for s in seeds if s in expected_s]
    average = sum(known) / len(known) if known else 0.0
    return sorted(seeds, key=lambda s: (-expected_s.get(s, average), s))


def _attempted(pool: Pool, todo: Sequence[int], scenario: Scenario, store: Store) -> Iterator[Event]:
    """Events of all episodes, committed; an episode that did not come to its end is run again or has failed."""
    failures: Counter[tuple[int, Kind]] = Counter()
    for event in pool.run(todo):
        if isinstance(event, Event):
            _commit(store, event)
            yield event
            continue
        failures[event.seed, event.kind] += 1
        if failures[event.seed, event.kind] <= RETRIES[event.kind]:
            store.forget_unfinished(event.seed)
            pool.again(event.seed)
            yield Event(event.seed)
        else:
            for ending in _failed(store, scenario, event):
                _commit(store, ending)
                yield ending


def _commit(store: Store, event: Event) -> None:
    if event.attempt is not None:
        store.add_attempt(event.attempt)
    if event.episode is not None:
        store.add_episode(event.episode)


def _failed(store: Store, scenario: Scenario, failure: Failure) -> list[Event]:
    """A failed attempt with reason `simulation_error`, and the end of its episode."""
    mine = store.attempts(failure.seed)
    picked = sum(a.success for a in mine)
    last = AttemptRecord(
        seed=failure.seed,
        attempt=len(mine),
        moved=True,
        success=False,
        reason=Reason.SIMULATION_ERROR,
        parts_in_bin_before=scenario.count - picked,
        n_estimates=0,
        tree={"error": failure.message},
    )
    end = EpisodeRecord(failure.seed, scenario.count, picked, "stopped", len(mine) + 1, sum(a.wall_s for a in mine))
    return [Event(failure.seed, attempt=last), Event(failure.seed, episode=end)]


def _check_same(store: Store, identity: dict[str, Any], episodes: int, out: Path) -> None:
    stored = store.meta()
    different = changed(stored, identity)
    if different:
        raise InputError(
            "command line",
            f"--resume {out}",
            f"changed: {', '.join(different)}",
            "what the results there were made with",
        )
    if episodes < stored["episodes"]:
        raise InputError("command line", "--episodes", episodes, f"at least {stored['episodes']} as in {out}")


@contextmanager
def _signals_noted() -> Iterator[Callable[[], bool]]:
    """Ctrl-C and SIGTERM are noted, not raised, so that they never fall between a message and its commit."""
    noted: list[int] = []
    mine = (signal.SIGINT, signal.SIGTERM) if threading.current_thread() is threading.main_thread() else ()
    before = {s: signal.signal(s, lambda number, _: noted.append(number)) for s in mine}
    try:
        yield lambda: bool(noted)
    finally:
        for s, handler in before.items():
            signal.signal(s, handler)
