"""Parametric CAD of the candlestick: `python scenarios/workpieces/candlestick/make_cad.py` writes candlestick.ply [mm].

Envelope 89 x 89 x 141 mm (the paper's Candlestick), infinite symmetry about z and none about x and y: foot, stem with a
knob, drip pan and cup.
"""

from __future__ import annotations

from pathlib import Path

from pickproof.scenarios.workpieces.cad import Solid, cylinder, revolved, write

# (radius, z), counter-clockwise from the middle of the foot
PROFILE = [
    (0, 0), (44.5, 0), (44.5, 7), (41, 10), (24, 15), (14, 20), (11, 28), (11, 54), (17, 58), (19, 64), (17, 70),
    (11, 74), (11, 104), (14, 109), (33, 111), (33, 116), (17, 117), (17, 141), (11.5, 141), (11.5, 119), (0, 119),
]  # fmt: skip
# (radius, low, high) of the cylinders that stand for it
PIECES = [
    (44.5, 0, 8.5), (41, 8.5, 10.5), (34, 10.5, 12.5), (26.5, 12.5, 14.5), (21, 14.5, 16.5), (16.5, 16.5, 18.5),
    (12.5, 18.5, 24), (11, 24, 110), (18.5, 57, 71.5), (33, 109, 116), (17, 116, 141),
]  # fmt: skip


def build() -> Solid:
    """The workpiece as a solid."""
    body = revolved(PROFILE)
    for radius, low, high in PIECES:
        body = Solid(body.body, body.pieces + cylinder(radius, (0, 0, low), high - low).pieces)
    return body.centred()


if __name__ == "__main__":
    write(build(), Path(__file__).parent / "candlestick.ply")
