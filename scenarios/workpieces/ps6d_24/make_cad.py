"""Parametric CAD of the spider: `python scenarios/workpieces/ps6d_24/make_cad.py` writes ps6d_24.ply [mm].

Envelope 244 x 240 x 50 mm (the paper's PS6D_24), 2-fold about x, y and z: a bored hub with two broad flat arms that end
in drilled pads, and two narrow high ones that end in eyes. The arms differ, so a quarter turn is no symmetry.
"""

from __future__ import annotations

from pathlib import Path

from pickproof.scenarios.workpieces.cad import Solid, box, cylinder, write


def build() -> Solid:
    """The workpiece as a solid."""
    hub = cylinder(38.0, (0, 0, -25), 50.0)
    arms = (
        box((-122, -27, -9), (122, 27, 9))  # broad
        + box((-17, -94, -15), (17, 94, 15))  # narrow
        + box((88, -50, -13), (122, 50, 13))  # pads
        + box((-122, -50, -13), (-88, 50, 13))
        + cylinder(27.0, (0, 93, -17), 34.0)  # eyes
        + cylinder(27.0, (0, -93, -17), 34.0)
    )
    bores = cylinder(21.0, (0, 0, -30), 60.0)
    for y in (93, -93):
        bores += cylinder(14.0, (0, y, -20), 40.0, segments=32)
    for x in (106, -106):
        for y in (33, -33):
            bores += cylinder(8.0, (x, y, -20), 40.0, segments=24)
    return (hub + arms - bores).centred()


if __name__ == "__main__":
    write(build(), Path(__file__).parent / "ps6d_24.ply")
