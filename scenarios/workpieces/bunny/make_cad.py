"""Parametric CAD of the hare: `python scenarios/workpieces/bunny/make_cad.py` writes bunny.ply and hulls.obj [mm].

Envelope 41 x 38 x 56 mm (the paper's Bunny), no symmetry: a sitting hare of our own, a smooth blend of ellipsoids on a
flat base, its head turned, one ear up and one folded back. The collision pieces are those ellipsoids.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import manifold3d as m3
import numpy as np
import trimesh

from pickproof.cell.frames import Array, apply, from_rpy, invert
from pickproof.scenarios.workpieces.cad import Solid, write

EXTENTS = (41.0, 38.0, 56.0)
EDGE = 2.5  # of the triangles
COARSEN = 0.2  # by which the surface may move to save triangles
BLEND = 1.4  # width of the blend
# centre, radii, roll, pitch and yaw in degrees; sizes before scaling to EXTENTS
ELLIPSOIDS = [
    ((-3, 0, 14), (16, 13, 14), (0, -20, 0)),  # body
    ((-8, 10, 8), (11, 6, 9), (0, 0, -10)),  # left haunch
    ((-5, -10, 9), (9, 6, 8), (0, 15, 20)),  # right haunch
    ((9, 3, 30), (11, 8.5, 8.5), (0, 15, 35)),  # head
    ((5, 9, 45), (4.5, 3, 13), (-10, -10, 20)),  # left ear, up
    ((-4, -4, 36), (4.5, 3, 13), (15, -60, 15)),  # right ear, folded back
    ((-20, -4, 8), (6, 6, 6), (0, 0, 0)),  # tail
    ((14, 7, 4), (8, 4.5, 5), (0, 0, 15)),  # left paw
    ((12, -7, 11), (5, 4, 8), (-15, 25, 0)),  # right paw, lifted
]


def frames() -> list[tuple[Array, Array]]:
    """Pose (4, 4) and radii (3,) of the ellipsoids."""
    return [(from_rpy(centre, np.deg2rad(rpy)), np.asarray(radii, float)) for centre, radii, rpy in ELLIPSOIDS]


def blend(x: float, y: float, z: float) -> float:
    """Positive inside the hare: minus the smooth minimum of the distances to the ellipsoids."""
    p = TO_SPHERES @ (x, y, z, 1.0)
    k = np.sqrt((p**2).sum(axis=1)) + 1e-9
    distances = k * (k - 1) / (np.sqrt(((p / RADII) ** 2).sum(axis=1)) + 1e-9)
    return float(BLEND * np.log(np.exp(-np.clip(distances, -30, 60) / BLEND).sum()))


RADII = np.stack([radii for _, radii in frames()])
TO_SPHERES = np.stack([invert(T)[:3] for T, _ in frames()]) / RADII[:, :, None]
"""(n, 3, 4) that map an ellipsoid to the unit sphere."""


@cache
def blended() -> m3.Manifold:
    """The body: blended ellipsoids, cut flat below, with few triangles."""
    body = m3.Manifold.level_set(blend, (-32, -24, -8, 28, 24, 64), EDGE)
    return body.trim_by_plane((0, 0, 1), 0.0).simplify(COARSEN)


def to_part(body: m3.Manifold) -> tuple[Array, Array]:
    """Scale (3,) and offset (3,) that bring the body into its envelope about the origin."""
    low, high = np.split(np.asarray(body.bounding_box()), 2)
    scale = np.asarray(EXTENTS) / (high - low)
    return scale, -scale * (low + high) / 2


def build() -> Solid:
    """The workpiece as a solid."""
    body = blended()
    scale, offset = to_part(body)
    return Solid(body.scale(scale.tolist()).translate(offset.tolist()))


def hulls() -> list[Array]:
    """Vertices (n, 3) of the collision pieces: the ellipsoids, a little larger than their inscribed polyhedra."""
    scale, offset = to_part(blended())
    sphere = trimesh.creation.icosphere(subdivisions=1, radius=1.08).vertices
    pieces = []
    for T, radii in frames():
        vertices = apply(T, sphere * radii)
        vertices[:, 2] = np.maximum(vertices[:, 2], 0.0)
        pieces.append(vertices * scale + offset)
    return pieces


if __name__ == "__main__":
    folder = Path(__file__).parent
    write(build(), folder / "bunny.ply")
    lines = []
    for i, vertices in enumerate(hulls()):
        lines += [f"o ellipsoid{i}", *(f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in vertices)]
    (folder / "hulls.obj").write_text("\n".join(lines) + "\n")
