"""Parametric CAD of the gear shaft: `python scenarios/workpieces/gear_shaft/make_cad.py` writes gear_shaft.ply [mm].

Envelope 99 x 99 x 436 mm (the paper's IPAGearShaft): 36 teeth, so 10 degrees about z, which is finer than T_s and
counts as infinite; no symmetry end to end, since the gear sits at a third of a stepped shaft.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pickproof.scenarios.workpieces.cad import Solid, cylinder, extruded, write

TEETH = 36
MODULE = 99.0 / (TEETH + 2)  # tip diameter = module (teeth + 2)
TIP, ROOT = 49.5, 49.5 - 2.25 * MODULE
GEAR = (112.0, 156.0)  # z
WEB = (27.0, 37.0, 14.0)  # inner and outer radius, depth of the groove turned into both faces of the gear
STEPS = [(11.0, 0, 62), (15.0, 62, 112), (21.0, 156, 190), (15.0, 190, 318), (19.0, 318, 330), (11.5, 330, 436)]
"""(radius, low, high) of the shaft"""


def gear_outline() -> np.ndarray:
    """Trapezoidal teeth, one of them on x: (4 TEETH, 2) points."""
    pitch = 2 * np.pi / TEETH
    angles = pitch * (np.arange(TEETH)[:, None] + np.array([-0.36, -0.12, 0.12, 0.36]))
    radii = np.broadcast_to([ROOT, TIP, TIP, ROOT], angles.shape)
    return np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=-1).reshape(-1, 2)


def build() -> Solid:
    """The workpiece as a solid."""
    body = extruded(gear_outline(), *GEAR)
    inner, outer, depth = WEB
    for start in (GEAR[0] - 1, GEAR[1] - depth):
        ring = cylinder(outer, (0, 0, start), depth + 1, segments=TEETH)
        body -= ring - cylinder(inner, (0, 0, start), depth + 1, segments=TEETH)
    for radius, low, high in STEPS:
        body += cylinder(radius, (0, 0, low), high - low, segments=TEETH)
    rim = cylinder(TIP, (0, 0, GEAR[0]), GEAR[1] - GEAR[0]).pieces
    return Solid(body.body, body.pieces + rim).centred()


if __name__ == "__main__":
    write(build(), Path(__file__).parent / "gear_shaft.ply")
