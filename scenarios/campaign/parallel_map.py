"""Parallel work other than episodes, in processes of this machine: one thread each, results in task order."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

from pickproof.cell.child_process import child_environment
from pickproof.scenarios.campaign.executor import WORKER_ENVIRONMENT

Map = Callable[..., Iterator[Any]]
"""Signature of a map: a function and its tasks to the results, in the order of the tasks."""


@contextmanager
def mapping(workers: int) -> Iterator[Map]:
    """A `map` over `workers` processes, or in this process; its function must not keep state between tasks."""
    if workers == 1:
        yield map
        return
    with child_environment(WORKER_ENVIRONMENT):
        pool = ProcessPoolExecutor(workers, get_context("spawn"), _start)
        try:
            yield pool.map
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _start() -> None:
    """Set up a worker: it ignores Ctrl-C (the driver ends it), and does not write to stdout, which may hold JSON."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)
