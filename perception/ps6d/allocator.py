"""Setting of the C allocator for large blocks; its default costs more CPU time than any operation of the network."""

from __future__ import annotations

import ctypes

M_TRIM_THRESHOLD, M_MMAP_MAX = -1, -4  # malloc.h of glibc


def keep_freed_memory() -> None:
    """Keep large freed blocks in this process (glibc's mallopt); nothing with another C library.

    Otherwise each activation beyond 32 MB is a new mapping whose pages the kernel clears again at every step.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_MAX, 0)
        mallopt(M_TRIM_THRESHOLD, 2**31 - 1)
