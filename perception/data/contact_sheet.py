"""A sheet of small pictures of scenes, from the fewest workpieces to the most."""

from __future__ import annotations

from colorsys import hsv_to_rgb
from pathlib import Path

import cv2
import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.sensing.camera import Render
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.data.overlay import png
from pickproof.perception.data.scenes import overhead_view, render_heap

LIGHT = np.array([-0.45, -0.6, -0.66])
"""Direction to the light in camera coordinates: from above left."""
GOLDEN = 0.618033988749895  # hues this far apart stay distinct however many there are


def draw_contact_sheet(workpiece: Workpiece, heaps: list[Array], path: Path, shown: int = 12, columns: int = 4) -> None:
    """Write a picture of up to `shown` scenes Ts_world_part (n, 4, 4), evenly spread over their numbers of parts."""
    order = np.argsort([len(poses) for poses in heaps], kind="stable")
    chosen = order[np.unique(np.linspace(0, len(order) - 1, min(shown, len(order))).round().astype(int))]
    tiles = [_tile(workpiece, heaps[i], f"scene {i}: {len(heaps[i])}") for i in chosen]
    columns = min(columns, len(tiles))
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % columns)
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    path.write_bytes(png(np.vstack(rows)))


def _tile(workpiece: Workpiece, poses: Array, text: str) -> np.ndarray:
    exact = render_heap(workpiece, poses, overhead_view(workpiece))
    image = cv2.resize(shaded(exact), (400, 300), interpolation=cv2.INTER_AREA)
    cv2.putText(image, text, (8, 290), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (20, 20, 20), 1, cv2.LINE_AA)
    return image


def shaded(exact: Render) -> np.ndarray:
    """(h, w, 3) uint8 BGR: workpieces in a hue each, everything else grey, under one light."""
    light = LIGHT / np.linalg.norm(LIGHT)
    bright = 0.35 + 0.65 * np.clip(exact.normals @ light, 0, 1)
    hues = [hsv_to_rgb((0.08 + i * GOLDEN) % 1.0, 0.55, 1.0)[::-1] for i in range(int(exact.ids.max()) + 1)]
    colours = np.array([*hues, (0.78, 0.8, 0.82)])  # the last one is for index -1
    image = np.where((exact.depth > 0)[..., None], colours[exact.ids] * bright[..., None], 1.0)
    return np.rint(255 * image).astype(np.uint8)
