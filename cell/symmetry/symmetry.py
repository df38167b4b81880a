"""Symmetry of a workpiece as the paper records it: degrees about x, y, z and the threshold T_s (PS6D, sec. III-C)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pickproof.cell.frames import Array, about_axis

INFINITE_BELOW_DEG = 15.0
"""T_s of the paper: a rotational symmetry finer than this counts as infinite."""


@dataclass(frozen=True)
class Symmetry:
    """The rotations that leave a workpiece unchanged.

    Attributes:
        degrees: d_x, d_y, d_z in [deg]: the smallest rotation about each CAD axis that maps the part to itself; 0 for
            none. A value of at most `infinite_below` counts as infinite symmetry about that axis.
        S: (k, 3, 3) the finite group, identity first (the paper's S).
        v: (3,) the paper's v: ones; with infinite symmetry one on that axis and zero elsewhere; zeros for a sphere.
    """

    degrees: tuple[float, float, float] = (0.0, 0.0, 0.0)
    infinite_below: float = INFINITE_BELOW_DEG
    S: Array = field(init=False, repr=False)
    v: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        infinite = [0 < d <= self.infinite_below for d in self.degrees]
        v = np.ones(3) if not any(infinite) else np.asarray(infinite, dtype=np.float64)
        if sum(infinite) > 1:
            v = np.zeros(3)
        generators = [
            about_axis(np.eye(3)[axis], np.deg2rad(d))[:3, :3]
            for axis, d in enumerate(self.degrees)
            if d > 0 and not infinite[axis] and sum(infinite) <= 1
        ]
        S = _group(generators)
        S.flags.writeable = v.flags.writeable = False
        object.__setattr__(self, "S", S)
        object.__setattr__(self, "v", v)

    @property
    def infinite_axis(self) -> int | None:
        """Index of the axis of infinite symmetry, or None."""
        return int(np.argmax(self.v)) if self.v.sum() == 1 else None

    @property
    def is_sphere(self) -> bool:
        """Whether every rotation maps the workpiece onto itself."""
        return not self.v.any()

    @property
    def size(self) -> int:
        """Rotations in the group, an infinite axis counted as a thousand and a sphere as a million."""
        return 1_000_000 if self.is_sphere else len(self.S) * (1 if self.infinite_axis is None else 1000)

    @property
    def fixed(self) -> Array:
        """Projection (3, 3) on the points that all rotations leave where they are: all, a line or the origin."""
        return np.zeros((3, 3)) if self.is_sphere else np.asarray(self.rotations().mean(axis=0))

    def rotations(self, infinite_steps: int = 24) -> Array:
        """Rotations (k, 3, 3) that map the part to itself, an infinite axis sampled in `infinite_steps` steps."""
        if self.infinite_axis is None:
            return self.S
        turns = about_axis(np.eye(3)[self.infinite_axis], np.arange(infinite_steps) * 2 * np.pi / infinite_steps)
        return np.einsum("aij,bjk->abik", self.S, turns[:, :3, :3]).reshape(-1, 3, 3)


def _group(generators: list[Array]) -> Array:
    """Closure of the generators under multiplication (at most 120 elements: the full icosahedral group)."""
    group = [np.eye(3)]
    frontier = [np.eye(3)]
    while frontier and len(group) <= 120:
        new = []
        for a in frontier:
            for g in generators:
                b = a @ g
                if np.abs(np.asarray(group) - b).max(axis=(1, 2)).min() >= 1e-6:
                    group.append(b)
                    new.append(b)
        frontier = new
    if len(group) > 120:
        raise ValueError(f"degrees {generators} do not generate a finite rotation group")
    return np.asarray(group)
