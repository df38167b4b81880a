"""A mesh on its way to a closed surface, and what was done to it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import trimesh

from pickproof.cell.frames import Array


@dataclass
class Checked:
    """A closed mesh in [m], and what was done to it in words.

    Attributes:
        vertices, faces: (n, 3), (m, 3).
        notes: a line for each repair.
        volume_change: share of the volume by which repairs changed it, 0 where they kept the shape.
        moved: [m] by which repairs moved the surface at most.
    """

    vertices: Array
    faces: np.ndarray
    notes: list[str] = field(default_factory=list)
    volume_change: float = 0.0
    moved: float = 0.0


def as_trimesh(checked: Checked) -> trimesh.Trimesh:
    """The mesh in [m]."""
    return trimesh.Trimesh(checked.vertices, checked.faces, process=False)
