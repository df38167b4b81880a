"""Parametric CAD of the bracket: `python scenarios/workpieces/bracket/make_cad.py` writes bracket.ply [mm].

Envelope 56 x 18 x 14 mm (the paper's PS6D_6), no symmetry: a stepped base plate with a mounting hole, an end flange,
and a rib along one edge. Every face seen alone is asymmetric, so that one view tells the pose.
"""

from __future__ import annotations

from pathlib import Path

import manifold3d as m3
import numpy as np
import trimesh

# (minimum corner, maximum corner) in [mm], before centring on the bounding box; collision_boxes repeats these
BOXES = [
    ((-28, -9, 0), (-8, 3, 5)),  # narrow end of the plate
    ((-8, -9, 0), (28, 9, 5)),  # wide end of the plate
    ((20, -9, 5), (28, 9, 14)),  # end flange
    ((-8, -9, 5), (20, -4, 9)),  # rib
]
HOLE_CENTRE, HOLE_DIAMETER = (-18, -3), 6.0
CENTRE = np.array([0.0, 0.0, 7.0])


def build() -> trimesh.Trimesh:
    """The workpiece as a mesh."""
    body = m3.Manifold()
    for low, high in BOXES:
        size = np.subtract(high, low)
        body += m3.Manifold.cube(size).translate(low)
    hole = m3.Manifold.cylinder(20, HOLE_DIAMETER / 2, HOLE_DIAMETER / 2, 48).translate((*HOLE_CENTRE, -5))
    mesh = (body - hole).to_mesh()
    part = trimesh.Trimesh(np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts))
    part.apply_translation(-CENTRE)
    return part


if __name__ == "__main__":
    part = build()
    assert part.is_watertight
    part.export(Path(__file__).parent / "bracket.ply")
    print(f"extents {part.extents} mm, volume {part.volume:.0f} mm3")
    for low, high in BOXES:
        size, centre = np.subtract(high, low), np.add(low, high) / 2 - CENTRE
        print(f"  - {{size: {(size / 1000).tolist()}, centre: {(centre / 1000).tolist()}}}")
