"""The campaign: episodes of one scenario at seeds s, s + 1, ... in worker processes, one writer in the driver.

Each worker is a fresh process (spawn) with a pipe of its own, so one that is killed in the middle of a message harms
no other. An episode depends on its scenario and seed alone: the record hash is the same for any number of workers.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from cell.errors import InputError, PickproofError, SimulationError
from cell.processes import child_environment
from scenarios.provenance import provenance
from scenarios.records import AttemptRecord, EpisodeRecord, Reason
from scenarios.scenario import Scenario, scenario_hash, scenario_json
from scenarios.store import Store, versions

Runner = Callable[[Scenario, int, frozenset[str], Callable[[AttemptRecord], None], bool], EpisodeRecord]
"""(scenario, seed, oracle, on_attempt, pictures) -> how the episode ended; importable by name in a fresh process."""

STALL_S = 900.0
"""[s] without any word from a busy worker after which it is taken for dead."""

_LIBRARIES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMEXPR_NUM_THREADS")
# one thread a worker, and no GPU: the order of additions, and so the results, must not depend on the machine's load
_WORKER_ENVIRONMENT = {**dict.fromkeys(_LIBRARIES, "1"), "OMP_WAIT_POLICY": "PASSIVE", "CUDA_VISIBLE_DEVICES": ""}
_POLL_S = 0.25


@dataclass(frozen=True)
class Event:
    """Something that happened: an attempt or an episode ended, or an episode is run again."""

    seed: int
    attempt: AttemptRecord | None = None
    episode: EpisodeRecord | None = None


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
    on_event: Callable[[Event], None] = lambda event: None,
    stall_s: float = STALL_S,
) -> None:
    """Run the episodes that `out` does not hold yet and commit every attempt as it ends.

    Args:
        oracle: stages replaced by ground truth.
        runner: runs one episode; it is sent to the workers by its import path.
        command: the command line, for the report.
        on_event: called in the driver after each commit.

    Raises:
        InputError: `out` holds results and `resume` is off, or they are of another campaign.
        KeyboardInterrupt: Ctrl-C or SIGTERM; what had ended is committed.
    """
    identity = {
        "scenario_hash": scenario_hash(scenario),
        "seed": seed,
        "oracle": sorted(oracle),
        "weights_hash": weights_hash,
        "versions": versions(),
    }
    meta = identity | {"scenario": scenario_json(scenario), "episodes": episodes, "command": command}
    meta |= provenance()
    begun = time.perf_counter()
    with (
        _signals_noted() as interrupted,
        Store.resume(out) if resume else Store.create(out, meta | {"wall_s": 0.0}) as store,
    ):
        if resume:
            _check_same(store, identity, episodes, out)
        wall_before = float(store.meta()["wall_s"])
        store.set_meta({"command": command, "episodes": episodes})
        store.forget_unfinished()
        done = {e.seed for e in store.episodes()}
        todo = [s for s in range(seed, seed + episodes) if s not in done]
        pool = _Pool(scenario, oracle, runner, pictures, min(workers, len(todo)), stall_s, interrupted)
        try:
            for event in _attempted(pool, todo, scenario, store):
                on_event(event)
        finally:
            pool.stop()
            for event in pool.leftover():
                _commit(store, event)
            store.set_meta({"wall_s": wall_before + time.perf_counter() - begun})


def _attempted(pool: _Pool, todo: Sequence[int], scenario: Scenario, store: Store) -> Iterator[Event]:
    """Events of all episodes, committed; an episode whose worker dies is run once more."""
    retried: set[int] = set()
    for event in pool.run(todo):
        if isinstance(event, Event):
            _commit(store, event)
            yield event
        elif event.died and event.seed not in retried:
            retried.add(event.seed)
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


def _failed(store: Store, scenario: Scenario, failure: _Failure) -> list[Event]:
    """A failed attempt with reason `simulation_error`, and the end of its episode."""
    mine = [a for a in store.attempts() if a.seed == failure.seed]
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
    for key, value in identity.items():
        if stored.get(key) != value:
            raise InputError(
                "command line", f"--resume {out}: {key}", value, f"{stored.get(key)!r} as in the results there"
            )
    if episodes < stored["episodes"]:
        raise InputError("command line", "--episodes", episodes, f"at least {stored['episodes']} as in {out}")


@dataclass(frozen=True)
class _Failure:
    seed: int
    message: str
    died: bool


@dataclass
class _Worker:
    process: BaseProcess
    pipe: Connection
    seed: int | None = None
    heard: float = field(default_factory=time.monotonic)


class _Pool:
    """Worker processes; each takes one seed at a time and sends events until the episode has ended."""

    def __init__(
        self,
        scenario: Scenario,
        oracle: frozenset[str],
        runner: Runner,
        pictures: bool,
        size: int,
        stall_s: float,
        interrupted: Callable[[], bool],
    ) -> None:
        self._interrupted = interrupted
        self._task = (scenario, oracle, runner, pictures)
        self._size, self._stall_s = size, stall_s
        self._workers: list[_Worker] = []
        self._waiting: deque[int] = deque()

    def run(self, seeds: Sequence[int]) -> Iterator[Event | _Failure]:
        """Events of the episodes, in the order in which they happen.

        Raises:
            PickproofError: a worker met bad input.
            RuntimeError: a worker met a bug; the message holds its traceback.
        """
        self._waiting.extend(seeds)
        while True:
            self._assign()
            busy = {w.pipe: w for w in self._workers if w.seed is not None}
            if not busy:
                return
            ready = wait(list(busy), timeout=min(self._stall_s, _POLL_S))
            if self._interrupted():
                raise KeyboardInterrupt
            for pipe in ready:
                yield from self._hear(busy[pipe])  # type: ignore[index]
            for worker in list(busy.values()):
                if worker.pipe not in ready and time.monotonic() - worker.heard > self._stall_s:
                    yield self._bury(worker, f"no word from the worker for {self._stall_s:.0f} s")

    def again(self, seed: int) -> None:
        """Put a seed back in front of the line."""
        self._waiting.appendleft(seed)

    def stop(self) -> None:
        """End all worker processes."""
        for worker in self._workers:
            if worker.seed is None:
                with suppress(OSError):
                    worker.pipe.send(None)
            else:
                worker.process.terminate()
        for worker in self._workers:
            worker.process.join(5)
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()

    def leftover(self) -> Iterator[Event]:
        """What stopped workers had sent and nobody had read."""
        for worker in self._workers:
            with suppress(EOFError, OSError):
                while True:
                    message = worker.pipe.recv()
                    if isinstance(message, Event):
                        yield message
            worker.pipe.close()
        self._workers.clear()

    def _assign(self) -> None:
        while self._waiting:
            idle = next((w for w in self._workers if w.seed is None), None)
            if idle is None and len(self._workers) < self._size:
                idle = self._start()
            if idle is None:
                return
            seed = self._waiting.popleft()
            try:
                idle.pipe.send(seed)
            except OSError:  # it died while idle
                self._waiting.appendleft(seed)
                self._remove(idle)
                continue
            idle.seed, idle.heard = seed, time.monotonic()

    def _start(self) -> _Worker:
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_work, args=(there, *self._task), daemon=True)
        with child_environment(_WORKER_ENVIRONMENT), _sigint_blocked():
            process.start()
        there.close()
        worker = _Worker(process, here)
        self._workers.append(worker)
        return worker

    def _hear(self, worker: _Worker) -> Iterator[Event | _Failure]:
        assert worker.seed is not None
        try:
            message = worker.pipe.recv()
        except (EOFError, OSError):
            worker.process.join(5)
            yield self._bury(worker, f"the worker process died (exit code {worker.process.exitcode})")
            return
        worker.heard = time.monotonic()
        if isinstance(message, PickproofError):
            raise message
        if isinstance(message, str):
            raise RuntimeError(f"episode {worker.seed} failed in its worker:\n{message}")
        if isinstance(message, _Failure) or message.episode is not None:
            worker.seed = None
        yield message

    def _bury(self, worker: _Worker, message: str) -> _Failure:
        assert worker.seed is not None
        self._remove(worker)
        return _Failure(worker.seed, message, died=True)

    def _remove(self, worker: _Worker) -> None:
        worker.process.kill()
        worker.process.join()
        worker.pipe.close()
        self._workers.remove(worker)


def _work(pipe: Connection, scenario: Scenario, oracle: frozenset[str], runner: Runner, pictures: bool) -> None:
    """A worker process: episodes until the driver says None or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the driver ends the workers
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)  # the physics engine chats on stdout, which may be a JSON document's
    os.close(nowhere)
    with suppress(EOFError, OSError):
        while (seed := pipe.recv()) is not None:
            try:
                episode = runner(scenario, seed, oracle, lambda a: pipe.send(Event(a.seed, attempt=a)), pictures)
                pipe.send(Event(seed, episode=episode))
            except SimulationError as error:  # the same again for the same seed: no second try
                pipe.send(_Failure(seed, str(error), died=False))
            except PickproofError as error:
                pipe.send(PickproofError(str(error)))
            except Exception as error:  # noqa: BLE001  handed to the driver, which raises it
                pipe.send("".join(traceback.format_exception(error)))


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


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    """Children started meanwhile never see Ctrl-C, not even while they import; here it is only delayed."""
    resource_tracker.ensure_running()  # starting it unblocks SIGINT
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
