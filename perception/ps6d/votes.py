"""What the network hands to clustering and refinement: one pose prediction for every voting point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Votes:
    """Predictions of m voting points in camera coordinates, normalised so that 1 is `workpiece.unit`.

    Attributes:
        points: (m, 3) measured positions p.
        centres: (m, 3) predicted positions t of the CAD origin.
        rotations: (m, 3, 3) predicted rotations, camera from CAD.
        cad_coordinates: (m, 3) predicted R^T (p - t), or None.
        confidence: (m,) in [0, 1], or None without that head.
    """

    points: np.ndarray
    centres: np.ndarray
    rotations: np.ndarray
    cad_coordinates: np.ndarray | None = None
    confidence: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.points)

    @property
    def middle(self) -> np.ndarray:
        """Mean predicted centre (3,)."""
        return np.asarray(self.centres.mean(0)) if len(self) else np.zeros(3)

    def select(self, index: np.ndarray) -> Votes:
        """The votes at `index` (indices or a mask)."""
        cad, sure = (None if x is None else x[index] for x in (self.cad_coordinates, self.confidence))
        return Votes(self.points[index], self.centres[index], self.rotations[index], cad, sure)

    def finite(self) -> Votes:
        """The votes without any NaN or infinity (a broken network must not stop a cell)."""
        ok = np.isfinite(self.points).all(1) & np.isfinite(self.centres).all(1)
        ok &= np.isfinite(self.rotations).all((1, 2))
        if self.cad_coordinates is not None:
            ok &= np.isfinite(self.cad_coordinates).all(1)
        if self.confidence is not None:
            ok &= np.isfinite(self.confidence)
        return self.select(ok)
