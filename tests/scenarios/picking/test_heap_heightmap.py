from __future__ import annotations

import numpy as np

from pickproof.scenarios.picking.heap_heightmap import LONE, supported


def kept(depth: np.ndarray) -> np.ndarray:
    h, w = depth.shape
    return np.array([[depth[v, u] > 0 and supported(depth, v, u) for u in range(w)] for v in range(h)])


def test_lone_pixels_have_no_support_and_surfaces_edges_and_lines_have() -> None:
    depth = np.full((20, 20), 1.0, np.float32)
    depth[:, 10:] = 1.2  # a step: both sides support themselves
    depth[5, 5] = 0.8  # flies
    depth[12, 9] = 1.1  # flies at the edge
    depth[3, 12:16] = 0.9  # a wire, but for its ends
    depth[17, 3] = 0.0  # missing
    good = kept(depth)
    lone = {(5, 5), (12, 9), (3, 12), (3, 15), (17, 3)}
    assert {tuple(map(int, p)) for p in np.argwhere(~good)} == lone


def test_a_steep_surface_is_kept() -> None:
    """Depth that falls by more than LONE a pixel in one direction is level in the other."""
    depth = np.tile(1.0 + 2 * LONE * np.arange(30, dtype=np.float32)[:, None], (1, 30))
    assert kept(depth)[:, 1:-1].all()
