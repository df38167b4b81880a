"""Solids in [m] made from parameters, with the symmetry that they have by construction."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import manifold3d as m3
import numpy as np
import trimesh

from pickproof.cell.frames import Array, make_transform, random_rotations

Degrees = tuple[float, float, float]


@dataclass(frozen=True)
class Shape:
    """A solid and the degrees of its symmetry in the frame that a search is to choose, 5 for any turn."""

    name: str
    mesh: trimesh.Trimesh
    degrees: Degrees

    @property
    def turned(self) -> Shape:
        """The same in a frame of its own."""
        T = make_transform(random_rotations(1, np.random.default_rng(len(self.name)))[0], (0.1, -0.2, 0.05))
        return Shape(f"{self.name} turned", self.mesh.copy().apply_transform(T), self.degrees)


def mesh_of(body: m3.Manifold) -> trimesh.Trimesh:
    """A manifold in [mm] as a mesh in [m]."""
    made = body.to_mesh64()
    vertices = 1e-3 * np.asarray(made.vert_properties)[:, :3]
    return trimesh.Trimesh(vertices, np.asarray(made.tri_verts, dtype=np.int64), process=False)


def extruded(outline: Array, height: float, twist_deg: float = 0.0, top: float = 1.0) -> m3.Manifold:
    """A prism in [mm] over an outline (n, 2), about z, its middle at the origin."""
    steps = int(abs(twist_deg) / 5)
    section = m3.CrossSection([np.asarray(outline).tolist()])
    return section.extrude(height, steps, twist_deg, (top, top)).translate((0, 0, -height / 2))


def polygon(n: int, radius: float) -> Array:
    """Corners (n, 2) of a regular polygon."""
    angles = 2 * np.pi * np.arange(n) / n
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def gear_outline(teeth: int, module: float, slant: float = 0.0) -> Array:
    """Corners (4 teeth, 2) of trapezoids on a circle; `slant` in shares of a pitch makes saw teeth of them."""
    root, tip = module * (teeth / 2 - 1.25), module * (teeth / 2 + 1)
    at = np.array([0.0, 0.18 + slant, 0.42 + slant, 0.6])
    angles = (2 * np.pi / teeth * (np.arange(teeth)[:, None] + at)).ravel()
    radii = np.tile([root, tip, tip, root], teeth)
    return radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def gear(teeth: int, module: float = 2.0, width: float = 12.0, slant: float = 0.0, hub: bool = False) -> m3.Manifold:
    """A spur gear in [mm] with a bore; with a hub on one side its faces differ."""
    body = extruded(gear_outline(teeth, module, slant), width)
    radius = module * (teeth / 2 - 1.25)
    if hub:
        body = body + m3.Manifold.cylinder(width, 0.6 * radius, 0.6 * radius, 64)
    return body - m3.Manifold.cylinder(5 * width, 0.3 * radius, 0.3 * radius, 64).translate((0, 0, -2 * width))


def bent_sheet(width: float = 40.0, legs: tuple[float, float] = (60.0, 35.0), thickness: float = 3.0) -> m3.Manifold:
    """An angle of sheet in [mm], a hole in one leg and a slot in the other."""
    base = m3.Manifold.cube((legs[0], width, thickness))
    wall = m3.Manifold.cube((thickness, width, legs[1]))
    hole = m3.Manifold.cylinder(20, 5, 5, 32).translate((0.7 * legs[0], 0.35 * width, -5))
    slot = m3.Manifold.cube((20, 0.3 * width, 8)).translate((-5, 0.2 * width, 0.6 * legs[1]))
    return base + wall - hole - slot


def pebble(size: float = 50.0, seed: int = 0) -> m3.Manifold:
    """A smooth body in [mm] without any symmetry: a sphere with a few random bumps and hollows."""
    rng = np.random.default_rng(seed)
    ball = trimesh.creation.icosphere(subdivisions=4)
    along = ball.vertices @ random_rotations(6, rng)[:, 0].T
    heights = rng.uniform(-0.25, 0.45, 6)
    radii = 1 + (heights * np.exp(-((1 - along) ** 2) / rng.uniform(0.05, 0.3, 6))).sum(axis=1)
    vertices = ball.vertices * radii[:, None] * (1.0, 0.8, 0.6)
    return m3.Manifold(m3.Mesh64(size / np.ptp(vertices) * vertices, ball.faces.astype(np.uint64)))


def noisy(mesh: trimesh.Trimesh, sigma: float, edge: float = 0.0012) -> trimesh.Trimesh:
    """A mesh as a scan gives it: corners every `edge` [m], each off by `sigma` [m] along each axis."""
    fine = mesh.subdivide_to_size(edge * 1.6, max_iter=20)
    fine.merge_vertices(digits_vertex=9)
    rng = np.random.default_rng(5)
    return trimesh.Trimesh(fine.vertices + rng.normal(0, sigma, fine.vertices.shape), fine.faces, process=False)


def _dihedral(n: int, infinite: bool = False) -> Degrees:
    step = 5.0 if infinite else 360.0 / n
    return (180.0, 180.0 if infinite or n % 2 == 0 else 0.0, step)


def shapes() -> Iterator[Shape]:
    """Over sixty shapes of all kinds."""
    for n in (3, 4, 5, 6, 7, 8, 9):
        yield Shape(f"prism {n}", mesh_of(extruded(polygon(n, 30), 25)), _dihedral(n))
        yield Shape(f"frustum {n}", mesh_of(extruded(polygon(n, 30), 40, top=0.4)), (0.0, 0.0, 360.0 / n))
    for n in (3, 4, 5, 8):
        yield Shape(f"twisted {n}", mesh_of(extruded(polygon(n, 30), 40, twist_deg=40)), _dihedral(n))
    for teeth in (*range(3, 12), 13, 16, 19, 20, 23, 24, 30, 37, 40):
        yield Shape(f"gear {teeth}", mesh_of(gear(teeth)), _dihedral(teeth))
    for teeth in (3, 5, 8, 12, 25, 40):
        yield Shape(f"saw {teeth}", mesh_of(gear(teeth, slant=0.3, hub=True)), (0.0, 0.0, 360.0 / teeth))
    yield Shape("ratchet 11", mesh_of(gear(11, slant=0.3)), (0.0, 0.0, 360.0 / 11))  # turned over, its teeth look back
    yield from _plain()
    yield from _nearly()
    for shape in (_named("gear 7"), _named("prism 3"), _named("frustum 5"), _named("saw 8"), _named("gear 40")):
        yield shape.turned
    for shape in (_named("prism 4"), _named("frustum 6"), _named("gear 7")):
        yield Shape(f"{shape.name} scanned", noisy(shape.mesh, 7e-5), shape.degrees)


def _named(name: str) -> Shape:
    kind, n = name.split()
    made = {"gear": lambda k: (gear(k), _dihedral(k)), "prism": lambda k: (extruded(polygon(k, 30), 25), _dihedral(k))}
    made["frustum"] = lambda k: (extruded(polygon(k, 30), 40, top=0.4), (0.0, 0.0, 360.0 / k))
    made["saw"] = lambda k: (gear(k, slant=0.3, hub=True), (0.0, 0.0, 360.0 / k))
    body, degrees = made[kind](int(n))
    return Shape(name, mesh_of(body), degrees)


def _plain() -> Iterator[Shape]:
    creation, mm = trimesh.creation, 1e-3
    yield Shape("cylinder", creation.cylinder(15 * mm, 60 * mm), (180, 180, 5))
    yield Shape("disc", creation.cylinder(40 * mm, 5 * mm, sections=96), (180, 180, 5))
    yield Shape("ring", creation.annulus(20 * mm, 30 * mm, 12 * mm, sections=64), (180, 180, 5))
    yield Shape("torus", creation.torus(30 * mm, 8 * mm, 64, 32), (180, 180, 5))
    yield Shape("capsule", creation.capsule(50 * mm, 12 * mm, count=[48, 48]), (180, 180, 5))
    yield Shape("cone", creation.cone(25 * mm, 60 * mm, sections=64), (0, 0, 5))
    profile = np.array([[0, 0], [20, 0], [22, 10], [8, 30], [12, 55], [0, 60]]) * mm
    yield Shape("turned knob", creation.revolve(profile, sections=64), (0, 0, 5))
    yield Shape("ball", creation.icosphere(4, 20 * mm), (5, 5, 5))
    yield Shape("large ball", creation.uv_sphere(60 * mm, count=[64, 64]), (5, 5, 5))
    yield Shape("brick", creation.box((60 * mm, 40 * mm, 20 * mm)), (180, 180, 180))
    yield Shape("bar", creation.box((400 * mm, 20 * mm, 20 * mm)), (180, 180, 90))
    yield Shape("cube", creation.box((40 * mm,) * 3), (90, 90, 90))
    yield Shape("octahedron", _solid(np.concatenate([np.eye(3), -np.eye(3)])), (90, 90, 90))
    yield Shape("tetrahedron", _solid(np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])), (180, 180, 180))
    # a fifth of a turn about z and half of one about x: the largest group that d_x, d_y, d_z can express
    yield Shape("icosahedron", creation.icosahedron().apply_scale(30 * mm), (180, 0, 72))
    yield Shape("pebble", mesh_of(pebble()), (0, 0, 0))
    yield Shape("bent sheet", mesh_of(bent_sheet()), (0, 0, 0))


def _nearly() -> Iterator[Shape]:
    """Shapes whose symmetry a feature of a millimetre breaks."""
    brick, cut = m3.Manifold.cube((60, 40, 20), True), m3.Manifold.cube
    notch = brick - cut((8, 8, 1)).translate((15, 5, 9))
    yield Shape("brick with a pocket 1 mm deep", mesh_of(notch), (0, 0, 0))
    step = brick + cut((10, 10, 1)).translate((-5, -5, 10))
    yield Shape("brick with a boss 1 mm high", mesh_of(step), (0, 0, 180))
    bar = m3.Manifold.cube((60, 40, 39), True)
    yield Shape("bar of nearly square section", mesh_of(bar), (180, 180, 180))
    flat = m3.Manifold.cylinder(60, 15, 15, 96, True) - cut((40, 40, 70), True).translate((34, 0, 0))
    yield Shape("pin with a flat 1 mm deep", mesh_of(flat), (0, 0, 180))
    taper = extruded(polygon(6, 20), 40, top=0.95)
    yield Shape("hexagon that tapers by 1 mm", mesh_of(taper), (0, 0, 60))


def _solid(corners: Array) -> trimesh.Trimesh:
    return trimesh.convex.convex_hull(0.03 * corners)


def own_parts() -> dict[str, m3.Manifold]:
    """The parts in [mm] of docs/measurements/onboarding.md; no shipped workpiece is alike."""
    return {"sprocket": gear(17, 2.0, 12, slant=0.2, hub=True), "angle": bent_sheet(), "knobble": pebble()}


if __name__ == "__main__":  # python -m tests.cell.workpiece.part_shapes FOLDER
    import sys
    from pathlib import Path

    for name, body in own_parts().items():
        mesh_of(body).apply_scale(1000).export(Path(sys.argv[1]) / f"{name}.stl")
