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
from typing import Any

from pickproof.cell.errors import InputError
from pickproof.cell.numerics import check_processor
from pickproof.scenarios.campaign.executor import Event, Failure, Kind, Pool, Task
from pickproof.scenarios.campaign.request import CampaignRequest
from pickproof.scenarios.config.input_hashes import changed, input_hashes, inputs_hash, versions
from pickproof.scenarios.config.provenance import provenance
from pickproof.scenarios.config.scenario import Scenario, scenario_hash, scenario_json
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord, Reason
from pickproof.scenarios.results.store import Store

RETRIES: dict[Kind, int] = {"broken": 0, "crashed": 1, "killed": 9}
"""How often an episode is repeated after each kind of failure; most often after a kill from outside, which has no cause
in the episode.
"""


def run_campaign(request: CampaignRequest, on_event: Callable[[Event], None] = lambda event: None) -> None:
    """Run the episodes that are missing in `request.out` and commit every attempt when it ends.

    Args:
        on_event: called in the driver after each commit.

    Raises:
        InputError: `out` holds results and `resume` is off, or they belong to another campaign; or the cluster does not
            exist; or this processor lacks instructions of the numeric profile.
        StoreError: the results cannot be written; committed attempts are kept and can be resumed.
        KeyboardInterrupt: Ctrl-C or SIGTERM; ended attempts are committed.
    """
    check_processor()
    begun, identity = time.perf_counter(), _identity(request)
    task = Task(request.runner, request.first_job, identity, request.stall_s)
    with (
        _signals_noted() as interrupted,
        _pool(task, request, interrupted) as pool,
        _store(request, identity) as store,
    ):
        wall_before = float(store.meta()["wall_s"])
        store.set_meta({"command": request.command, "episodes": request.episodes})
        store.forget_unfinished()
        done = {e.seed for e in store.episodes()}
        todo = _longest_first([s for s in request.seeds if s not in done], request.expected_s)
        try:
            for event in _attempted(pool, todo, request.scenario, store):
                on_event(event)
        finally:
            for event in pool.stop():
                _commit(store, event)
            store.set_meta({"wall_s": wall_before + time.perf_counter() - begun})


def _identity(request: CampaignRequest) -> dict[str, Any]:
    """Everything that decides the records: a campaign is continued, and an episode run, only where all of it is
    equal.
    """
    return {
        "scenario_hash": scenario_hash(request.scenario),
        "seed": request.seed,
        "oracle": sorted(request.oracle),
        "weights_hash": request.weights_hash,
        "inputs": input_hashes(request.scenario, request.oracle),
        "versions": versions(),
    }


def _store(request: CampaignRequest, identity: dict[str, Any]) -> Store:
    """The store of the results, new or continued."""
    if request.resume:
        store = Store.resume(request.out)
        try:
            _check_same(store, identity, request)
        except BaseException:
            store.close()
            raise
        return store
    told = {
        "scenario": scenario_json(request.scenario),
        "episodes": request.episodes,
        "command": request.command,
        "wall_s": 0.0,
    }
    return Store.create(request.out, identity | told | provenance() | {"inputs_hash": inputs_hash(identity["inputs"])})


@contextmanager
def _pool(task: Task, request: CampaignRequest, interrupted: Callable[[], bool]) -> Iterator[Pool]:
    if request.ray is None:
        from pickproof.scenarios.campaign.process_pool import Workers

        yield Workers(task, request.workers, interrupted)
    else:
        from pickproof.scenarios.campaign.ray_pool import connected

        with connected(request.ray, request.workers, task, interrupted) as pool:
            yield pool


def _longest_first(seeds: Sequence[int], expected_s: Mapping[int, float]) -> list[int]:
    """Seeds, longest episode first; unknown lengths count as average; equal ones stay in order of seed."""
    known = [expected_s[s] for s in seeds if s in expected_s]
    average = sum(known) / len(known) if known else 0.0
    return sorted(seeds, key=lambda s: (-expected_s.get(s, average), s))


def _attempted(pool: Pool, todo: Sequence[int], scenario: Scenario, store: Store) -> Iterator[Event]:
    """Events of all episodes, each committed; an episode that did not finish is repeated or fails."""
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


def _check_same(store: Store, identity: dict[str, Any], request: CampaignRequest) -> None:
    stored, out = store.meta(), request.out
    different = changed(stored, identity)
    if different:
        valid = "the inputs of the results there"
        raise InputError("command line", f"--resume {out}", f"changed: {', '.join(different)}", valid)
    if request.episodes < stored["episodes"]:
        raise InputError("command line", "--episodes", request.episodes, f"at least {stored['episodes']} as in {out}")


@contextmanager
def _signals_noted() -> Iterator[Callable[[], bool]]:
    """Ctrl-C and SIGTERM set a flag instead of raising, so that they never interrupt between a message and its
    commit.
    """
    noted: list[int] = []
    mine = (signal.SIGINT, signal.SIGTERM) if threading.current_thread() is threading.main_thread() else ()
    before = {s: signal.signal(s, lambda number, _: noted.append(number)) for s in mine}
    try:
        yield lambda: bool(noted)
    finally:
        for s, handler in before.items():
            signal.signal(s, handler)
