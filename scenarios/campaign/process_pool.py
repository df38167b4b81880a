"""Episodes in worker processes of this machine.

Each worker is a new process (spawn) with its own pipe, so a killed worker does not affect the others. In a pool with a
shared queue, a lock held by a killed process stays locked.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from pickproof.cell.child_process import child_environment, work_for
from pickproof.scenarios.campaign.executor import (
    WORKER_ENVIRONMENT,
    Event,
    Failure,
    Kind,
    Message,
    Task,
    checked,
    run_one,
)

_POLL_S = 0.25


@dataclass
class _Worker:
    process: BaseProcess
    pipe: Connection
    seed: int | None = None
    heard: float = field(default_factory=time.monotonic)


class Workers:
    """Worker processes; each runs one seed at a time and sends events until the episode has ended.

    Args:
        size: processes at most.
        interrupted: called several times per second; True stops the pool.
    """

    def __init__(self, task: Task, size: int, interrupted: Callable[[], bool]) -> None:
        self._task, self._size, self._interrupted = task, size, interrupted
        self._workers: list[_Worker] = []
        self._waiting: deque[int] = deque()

    def run(self, seeds: Sequence[int]) -> Iterator[Event | Failure]:
        """See `Pool.run`."""
        self._waiting.extend(seeds)
        while True:
            self._assign()
            busy = {w.pipe: w for w in self._workers if w.seed is not None}
            if not busy:
                return
            ready = wait(list(busy), timeout=min(self._task.stall_s, _POLL_S))
            if self._interrupted():
                raise KeyboardInterrupt
            for pipe in ready:
                yield self._hear(busy[pipe])  # type: ignore[index]
            for worker in list(busy.values()):
                if worker.pipe not in ready and time.monotonic() - worker.heard > self._task.stall_s:
                    yield self._bury(worker, f"no word from the worker for {self._task.stall_s:.0f} s", "crashed")

    def again(self, seed: int) -> None:
        """See `Pool.again`."""
        self._waiting.appendleft(seed)

    def stop(self) -> Iterator[Event]:
        """See `Pool.stop`."""
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
        work = pickle.dumps(partial(_work, self._task))
        process = context.Process(target=work_for, args=(os.getpid(), work, there), daemon=True)
        with child_environment(WORKER_ENVIRONMENT), _sigint_blocked():
            process.start()
        there.close()
        worker = _Worker(process, here)
        self._workers.append(worker)
        return worker

    def _hear(self, worker: _Worker) -> Event | Failure:
        assert worker.seed is not None
        try:
            message: Message = worker.pipe.recv()
        except (EOFError, OSError):
            worker.process.join(5)
            code = worker.process.exitcode
            from_outside = code in (-signal.SIGKILL, -signal.SIGTERM)
            return self._bury(
                worker, f"the worker process died (exit code {code})", "killed" if from_outside else "crashed"
            )
        worker.heard = time.monotonic()
        event = checked(message, worker.seed)
        if isinstance(event, Failure) or event.episode is not None:
            worker.seed = None
        return event

    def _bury(self, worker: _Worker, message: str, kind: Kind) -> Failure:
        assert worker.seed is not None
        self._remove(worker)
        return Failure(worker.seed, message, kind)

    def _remove(self, worker: _Worker) -> None:
        worker.process.kill()
        worker.process.join()
        worker.pipe.close()
        self._workers.remove(worker)


def _work(task: Task, pipe: Connection) -> None:
    """A worker process: episodes until the driver says None or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the driver ends the workers
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)  # the physics engine chats on stdout, which may be a JSON document's
    os.close(nowhere)
    with suppress(EOFError, OSError):
        while (seed := pipe.recv()) is not None:
            run_one(task, seed, pipe.send)


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    """Children started meanwhile never see Ctrl-C, not even while they import; here it is only delayed."""
    resource_tracker.ensure_running()  # starting it unblocks SIGINT
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
