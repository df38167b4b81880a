"""Parametric CAD of the angle bracket: `python scenarios/workpieces/ps6d_10/make_cad.py` writes ps6d_10.ply [mm].

Envelope 125 x 116 x 77 mm (the paper's PS6D_10), no symmetry: a cast base with a lug and a pad, an upright wall with a
bearing boss through it, and a stepped rib between the two.
"""

from __future__ import annotations

from pathlib import Path

from pickproof.scenarios.workpieces.cad import Solid, box, cylinder, write


def build() -> Solid:
    """The workpiece as a solid."""
    body = (
        box((0, 0, 0), (125, 88, 13))  # base
        + box((0, 0, 13), (14, 88, 62))  # wall
        + cylinder(22.0, (0, 30, 55), 46.0, axis="x")  # bearing boss, up to 77
        + box((14, 62, 13), (64, 73, 34))  # rib
        + box((14, 62, 34), (38, 73, 54))
        + box((76, 88, 0), (112, 116, 10))  # lug
        + cylinder(15.0, (102, 26, 13), 12.0)  # pad
    )
    bores = (
        cylinder(13.0, (-1, 30, 55), 60.0, axis="x")
        + cylinder(6.5, (94, 102, -1), 20.0, segments=32)
        + cylinder(7.0, (102, 26, -1), 40.0, segments=32)
        + box((60, -1, -1), (90, 60, 4))  # pocket underneath, open to one side
    )
    return (body - bores).centred()


if __name__ == "__main__":
    write(build(), Path(__file__).parent / "ps6d_10.ply")
