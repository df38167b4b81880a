"""Pictures of the cell for reports, drawn by PyBullet's software renderer; never what the sensor sees."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import numpy as np

from pickproof.cell.physics._pybullet import pybullet
from pickproof.cell.physics.world import World

BACKGROUND = (0.93, 0.94, 0.96)
TABLE = (0.80, 0.78, 0.74, 1.0)
BINS = ((0.27, 0.45, 0.62, 1.0), (0.33, 0.56, 0.44, 1.0), (0.58, 0.47, 0.62, 1.0))
GOLDEN = 0.618033988749895
"""Distinct colours: hues spaced by the golden ratio, for any number of workpieces."""


def cell_picture(
    world: World,
    eye: Sequence[float],
    target: Sequence[float],
    width: int = 640,
    height: int = 480,
    fov_deg: float = 45.0,
) -> np.ndarray:
    """The cell seen from `eye` towards `target` [m], as (height, width, 3) uint8; `fov_deg` is vertical."""
    client = world.client
    _paint(world)
    view = client.computeViewMatrix(list(eye), list(target), [0.0, 0.0, 1.0])
    projection = client.computeProjectionMatrixFOV(fov_deg, width / height, 0.02, 10.0)
    _, _, rgba, depth, _ = client.getCameraImage(
        width,
        height,
        view,
        projection,
        lightDirection=[-0.5, -0.8, 2.0],
        lightAmbientCoeff=0.55,
        lightDiffuseCoeff=0.5,
        lightSpecularCoeff=0.1,
        shadow=1,
        renderer=pybullet.ER_TINY_RENDERER,
    )
    image = np.reshape(np.asarray(rgba, dtype=np.uint8), (height, width, 4))[..., :3].copy()
    image[np.reshape(depth, (height, width)) >= 1.0] = np.rint(np.multiply(BACKGROUND, 255)).astype(np.uint8)
    return image


def _paint(world: World) -> None:
    groups: dict[str, int] = {}
    for name, body in world.boxes.items():
        if name == "table":
            colour = TABLE
        else:
            group = groups.setdefault(name.split("_")[0], len(groups))
            colour = BINS[group % len(BINS)]
        world.client.changeVisualShape(body, -1, rgbaColor=colour)
    for i, body in enumerate(world.parts):
        rgb = colorsys.hsv_to_rgb((0.08 + i * GOLDEN) % 1.0, 0.55, 0.92)
        world.client.changeVisualShape(body, -1, rgbaColor=[*rgb, 1.0])
