"""The one place that imports pybullet and opens a client.

Its C code writes `pybullet build time` at import and `argv[0]=` at every connection straight to the process's own
output, where the results of a command line tool belong; both file descriptors point elsewhere for that moment.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def _quiet() -> Iterator[None]:
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(1), os.dup(2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
    finally:
        for descriptor, old in zip((1, 2), kept, strict=True):
            os.dup2(old, descriptor)
            os.close(old)
        os.close(nowhere)


with _quiet():
    import pybullet
    from pybullet_utils.bullet_client import BulletClient


def connect() -> Any:
    """A new headless client with a world of its own."""
    with _quiet():
        client: Any = BulletClient(connection_mode=pybullet.DIRECT)
        client.resetSimulation()
    return client


__all__ = ["connect", "pybullet"]
