"""What the pages served by viser share: boxes, and poses of nodes."""

from __future__ import annotations

from typing import Any

import numpy as np

from pickproof.cell.frames import Array, to_quat_xyzw
from pickproof.cell.geometry.bin import Box

Colour = tuple[int, int, int]


def add_box(scene: Any, name: str, box: Box, colour: Colour, opacity: float | None = None) -> Any:
    """A box in the frame of the node above it."""
    return scene.add_box(name, color=colour, dimensions=box.size, opacity=opacity, **pose_of(box.T_world_box))


def pose_of(T: Array) -> dict[str, Any]:
    """A transform (4, 4) as the arguments that viser takes."""
    return {"wxyz": np.roll(to_quat_xyzw(T), 1), "position": T[:3, 3].astype(float)}


def move(handle: Any, T: Array) -> None:
    """Put a node at a transform (4, 4)."""
    pose = pose_of(T)
    handle.wxyz, handle.position = pose["wxyz"], pose["position"]
