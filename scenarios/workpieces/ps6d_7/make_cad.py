"""Parametric CAD of the lever: `python scenarios/workpieces/ps6d_7/make_cad.py` writes ps6d_7.ply [mm].

Envelope 216 x 81 x 38 mm (the paper's PS6D_7), no symmetry: a cast lever with a large and a small bored boss, a ribbed
arm between them, a foot on one side and an ear on the other.
"""

from __future__ import annotations

from pathlib import Path

from pickproof.scenarios.workpieces.cad import Solid, box, cylinder, write

LARGE_BOSS, SMALL_BOSS = (28.0, 40.0), (199.0, 33.0)  # axes


def build() -> Solid:
    """The workpiece as a solid."""
    body = (
        cylinder(28.0, (*LARGE_BOSS, 0), 38.0)
        + cylinder(17.0, (*SMALL_BOSS, 3), 22.0)
        + box((30, 26, 5), (200, 50, 17))  # arm
        + box((50, 40, 17), (160, 48, 29))  # rib
        + box((92, 0, 5), (142, 28, 15))  # foot
        + box((92, 0, 15), (104, 16, 30))  # lug on the foot
        + box((14, 62, 12), (40, 81, 22))  # ear
    )
    bores = (
        cylinder(15.0, (*LARGE_BOSS, -1), 40.0)
        + cylinder(8.0, (*SMALL_BOSS, 0), 40.0, segments=32)
        + cylinder(6.0, (124, 13, 0), 30.0, segments=32)
    )
    return (body - bores).centred()


if __name__ == "__main__":
    write(build(), Path(__file__).parent / "ps6d_7.ply")
