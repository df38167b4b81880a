"""One frame as the search sees it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickproof.cell.geometry.bin import Bin
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.perception.ps6d.votes import Votes
from pickproof.perception.refinement.depth_surface import SurfaceMap
from pickproof.perception.search.seeds import Seeds


@dataclass(frozen=True)
class Scene:
    """What is known of a frame.

    Attributes:
        frame: as measured; bin: None where none is known.
        surface: the same, normalised.
        points: where it is asked which poses lie there.
        votes: of a network; None without one.
    """

    frame: DepthFrame
    bin: Bin | None
    surface: SurfaceMap
    points: Seeds
    votes: Votes | None

    def half_image(self) -> tuple[np.ndarray, np.ndarray]:
        """Every second pixel (h, w, 5): depth, normal, nearest depth; and fx, fy, cx, cy (4,) of that image."""
        K = self.surface.intrinsics
        table = self.surface.table.numpy().reshape(K.height, K.width, 8)[::2, ::2]
        camera = np.array([K.fx / 2, K.fy / 2, K.cx / 2, K.cy / 2], np.float32)
        return np.ascontiguousarray(table[..., 2:7]), camera
