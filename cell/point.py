"""A point under a rigid transform, for loops that numba compiles."""

from __future__ import annotations

import numba


@numba.njit(cache=True)
def moved(T, p):  # type: ignore[no-untyped-def]
    """Coordinates x, y, z of T (4, 4) times the point p (3,)."""
    return (
        T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3],
        T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3],
        T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3],
    )
