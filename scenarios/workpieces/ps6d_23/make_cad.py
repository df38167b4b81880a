"""Parametric CAD of the hat rail: `python scenarios/workpieces/ps6d_23/make_cad.py` writes ps6d_23.ply [mm].

Envelope 1304 x 92 x 32 mm (the paper's PS6D_23), 2-fold about z, which looks out of the hat's top: an extruded hat
section with slots in its top and a gap in each brim, at one end on the left and at the other on the right.
"""

from __future__ import annotations

from pathlib import Path

from pickproof.scenarios.workpieces.cad import Solid, box, write

LENGTH, WIDTH, HEIGHT, WALL = 1304.0, 92.0, 32.0, 6.0
TOP = 54.0  # width of the hat without its brims
GAP = (170.0, 400.0)  # x of the brim that is missing
SLOTS = [(-560.0, -440.0), (-60.0, 60.0), (440.0, 560.0)]  # x


def build() -> Solid:
    """The workpiece as a solid."""
    x, y, brim = LENGTH / 2, TOP / 2, WIDTH / 2
    half = (
        box((-x, y - WALL, 0), (x, y, HEIGHT))  # side
        + box((-x, y, 0), (GAP[0], brim, WALL))  # brim, up to the gap
        + box((GAP[1], y, 0), (x, brim, WALL))
    )
    body = box((-x, -y, HEIGHT - WALL), (x, y, HEIGHT)) + half + half.turned_about_z(180)
    for low, high in SLOTS:
        body -= box((low, -10, 0), (high, 10, HEIGHT + 1))
    return body.centred()


if __name__ == "__main__":
    write(build(), Path(__file__).parent / "ps6d_23.ply")
