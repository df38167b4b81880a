"""What the pages served by viser share: a server of one machine, boxes, and poses of nodes."""

from __future__ import annotations

import contextlib
import io
from typing import Any

import numpy as np
import viser

from pickproof.cell.frames import Array, to_quat_xyzw
from pickproof.cell.geometry.bin import Box

HOST = "127.0.0.1"
Colour = tuple[int, int, int]


def serve(label: str, port: int) -> viser.ViserServer:
    """A page on the loopback interface alone, its panel at the right; port 0 takes a free one."""
    with contextlib.redirect_stdout(io.StringIO()):  # prints an address, which is not the one behind a gate
        server = viser.ViserServer(host=HOST, port=port, label=label, verbose=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.gui.main_panel.dock_right()
    server.scene.set_up_direction("+z")
    server.scene.configure_environment_map("warehouse", environment_intensity=0.25)
    server.scene.configure_default_lights(cast_shadow=False)
    server.initial_camera.up = (0.0, 0.0, 1.0)
    return server


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
