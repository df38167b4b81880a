"""Parametric CAD of the twin socket: `python scenarios/workpieces/tless_20/make_cad.py` writes tless_20.ply [mm].

Envelope 83 x 76 x 47 mm (the paper's Tless_20, an electrical part of that data set; the shape is our own), 2-fold about
z: two sockets on a base plate, a wall between them, lugs and terminals, each with a twin half a turn away. No mirror
image of it fits, so top, bottom and sides each tell the pose.
"""

from __future__ import annotations

from pathlib import Path

from pickproof.scenarios.workpieces.cad import Solid, box, cylinder, write

SOCKET = (20.0, 7.0)  # axis of one socket; the other is half a turn away
HEIGHT = 47.0


def build() -> Solid:
    """The workpiece as a solid."""
    half = (
        cylinder(18.0, (*SOCKET, 0), 40.0)
        + box((12, -38, 0), (36, -20, 9))  # mounting lug
        + box((28, -27, 0), (41.5, -9, 24))  # terminal
    )
    wall = box((-6, -26, 0), (6, 26, HEIGHT))
    body = box((-41.5, -27, 0), (41.5, 27, 12)) + wall + half + half.turned_about_z(180)
    cut = cylinder(14.5, (*SOCKET, 24), 30.0) + cylinder(3.0, (24, -32, -1), 20.0, segments=24)
    cut += box((8, -40, -1), (30, 10, 3))  # groove underneath, from one side to the middle
    return (body - cut - cut.turned_about_z(180)).centred()


if __name__ == "__main__":
    write(build(), Path(__file__).parent / "tless_20.ply")
