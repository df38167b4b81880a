"""Environment variables and threads of child processes, and their end with the parent process."""

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
"""Environment variable: folders that contain workpiece folders, separated as in PATH."""
_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@contextmanager
def child_environment(values: dict[str, str]) -> Iterator[None]:
    """Set environment variables for child processes that start inside this context; libraries read them at import."""
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
    """Child processes that start inside this context use one thread each."""
    return child_environment(dict.fromkeys(_THREADS, "1"))


def work_for(parent: int, work: bytes, *args: Any) -> None:
    """Target of a child process: call the pickled function `work`, and end with the process `parent` at the latest.

    The function is unpickled here because unpickling can import modules for seconds, and the parent can end meanwhile.
    """
    _die_with(parent)
    pickle.loads(work)(*args)


def _die_with(parent: int) -> None:
    """Let the operating system end this process when its parent is killed, even during a physics step."""
    if sys.platform != "linux":
        return  # on other systems the process ends at its next message to the parent
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # the parent was killed before the call
        os._exit(1)
