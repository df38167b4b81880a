"""Which addresses this process, and those below it, can be reached at, as the kernel tells it."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from tests.benchmarks.faults import descendants

LOOPBACK = ("0100007F", "0000000000000000FFFF00000100007F", "00000000000000000000000001000000")
"""127.0.0.1, the same in IPv6, and ::1, in the kernel's order of bytes."""


def listening() -> set[str]:
    """ADDRESS:PORT of all sockets that listen, in hexadecimal."""
    mine = set()
    for pid in (os.getpid(), *descendants(os.getpid())):
        with suppress(OSError):  # the process has ended
            for fd in list(Path(f"/proc/{pid}/fd").iterdir()):
                with suppress(OSError):  # closed meanwhile
                    mine.add(str(fd.readlink()))
    lines = [line.split() for kind in ("tcp", "tcp6") for line in Path(f"/proc/net/{kind}").read_text().splitlines()]
    return {words[1] for words in lines if words[3] == "0A" and f"socket:[{words[9]}]" in mine}


def on_loopback(addresses: set[str]) -> bool:
    """There are some, and none of them can be reached from another machine."""
    return bool(addresses) and {address.partition(":")[0] for address in addresses} <= set(LOOPBACK)
