"""Parametric CAD of the eye bolt: `python scenarios/workpieces/ring_screw/make_cad.py` writes ring_screw.ply [mm].

Envelope 99 x 65 x 151 mm (the paper's IPARingScrew), 2-fold about its long axis z: a ring in the x-z plane, a collar
and a shank, proportioned as an M30 eye bolt; its thread is a plain cylinder.
"""

from __future__ import annotations

from pathlib import Path

import manifold3d as m3
import numpy as np

from pickproof.scenarios.workpieces.cad import Piece, Solid, cylinder, write

LENGTH, RING_DIAMETER, COLLAR_DIAMETER = 151.0, 99.0, 65.0
WIRE_RADIUS = 11.0  # of the ring's round section
SHANK_RADIUS, SHANK_LENGTH, COLLAR_HEIGHT = 15.0, 46.0, 13.0
RING_PIECES = 12


def ring() -> Solid:
    """The ring about y through the origin; its pieces are cylinders that follow it."""
    radius = RING_DIAMETER / 2 - WIRE_RADIUS
    wire = m3.CrossSection.circle(WIRE_RADIUS, 16).translate((radius, 0))
    torus = Solid(wire.revolve(40).rotate((90, 0, 0)))
    length = 2 * radius * np.tan(np.pi / RING_PIECES) + 2.4  # a little over, as the ends gape outside
    pieces: tuple[Piece, ...] = ()
    for i in range(RING_PIECES):
        angle = 2 * np.pi * (i + 0.5) / RING_PIECES
        turn = np.eye(4)
        turn[:3, :3] = [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
        pieces += cylinder(WIRE_RADIUS, (radius, 0, -length / 2), length).moved(turn).pieces
    return Solid(torus.body, pieces)


def build() -> Solid:
    """The workpiece as a solid."""
    up = np.eye(4)
    up[2, 3] = LENGTH - RING_DIAMETER / 2
    shank = cylinder(SHANK_RADIUS, (0, 0, 0), SHANK_LENGTH + 1, segments=32)
    collar = cylinder(COLLAR_DIAMETER / 2, (0, 0, SHANK_LENGTH), COLLAR_HEIGHT)
    return (ring().moved(up) + shank + collar).centred()


if __name__ == "__main__":
    write(build(), Path(__file__).parent / "ring_screw.ply")
