"""What child processes inherit, and when they end."""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

FOLDERS = "PICKPROOF_WORKPIECES"
"""Variable of the environment: folders of workpiece folders, as PATH lists them."""
_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@contextmanager
def child_environment(values: dict[str, str]) -> Iterator[None]:
    """Set variables for the child processes started meanwhile; libraries read them at import."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def single_threaded_children() -> AbstractContextManager[None]:
    """Processes started meanwhile use one thread each."""
    return child_environment(dict.fromkeys(_THREADS, "1"))


def work_for(parent: int, work: bytes, *args: Any) -> None:
    """Target of a child process: call the pickled function `work`, and end with the process `parent` at the latest.

    The function is unpickled here, since that may import for seconds, in which the parent may already be killed.
    """
    _die_with(parent)
    pickle.loads(work)(*args)


def _die_with(parent: int) -> None:
    """Have the system end this process when its parent is killed, even in the middle of a step of the physics."""
    if sys.platform != "linux":
        return  # elsewhere it ends when it next speaks to its parent
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it was killed before the call
        os._exit(1)
