"""Why a mesh cannot become a workpiece, and where it is at fault."""

from __future__ import annotations

import numpy as np

from pickproof.cell.frames import Array


class MeshError(Exception):
    """What was found, and what would have been accepted; it becomes an InputError where the file's name is known."""

    def __init__(self, found: str, valid: str) -> None:
        super().__init__(found, valid)
        self.found, self.valid = found, valid


class TornError(MeshError):
    """A surface whose faces do not bound a solid; a remesh from its distance field may still find what is meant."""


def near(points: Array) -> str:
    """The middle of points (n, 3) [m] in the file's own frame, in words."""
    x, y, z = (1000 * np.asarray(points).reshape(-1, 3).mean(axis=0) + 0.0).tolist()
    return f"at ({x:.1f}, {y:.1f}, {z:.1f}) mm"
