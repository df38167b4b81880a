"""The last resort: a surface that does not close, or passes through itself, made anew from its distance field.

Every point of a grid counts as inside where most of three lines along x, y and z have entered the surface more often
than they left it before they come there; next to the surface the distance to it takes this sign, and marching cubes
(Lorensen and Cline 1987, as `skimage.measure.marching_cubes`) draws the surface of distance 0. Edges become as round
as the grid is wide. What moved, and the volume, is measured and said.
"""

from __future__ import annotations

from collections.abc import Iterator

import manifold3d as m3
import numpy as np
import trimesh
from scipy import ndimage

from pickproof.cell.frames import Array
from pickproof.cell.geometry.nearest import Nearest
from pickproof.cell.mesh.bodies import LOST, arrays, manifold
from pickproof.cell.mesh.checked import Checked
from pickproof.cell.mesh.clean import extent
from pickproof.cell.mesh.error import MeshError

PITCH = (1e-4, 2e-4)
"""[m] of the grid, finest and coarsest; a part of many grid points gets a coarser one, up to COARSE of its size."""
SIDE, COARSE = 400, 0.004
MOST_POINTS = 16_000_000
"""Of the grid: 16 MB for each of its fields of bytes, 64 MB for the distances."""
CHUNK = 4_000_000
TORN = 0.03
"""Share of lines that may enter more or less often than they leave, as through a hole."""
SAMPLES = 20_000


def remesh(mesh: Checked) -> None:
    """Replace a surface by that of its distance field.

    Raises:
        MeshError: it does not tell inside from outside, or the new surface is off by more than LOST of the volume.
    """
    size = extent(mesh.vertices)
    pitch = max(min(max(size / SIDE, PITCH[0]), PITCH[1]), _least_pitch(mesh.vertices))
    if pitch > max(PITCH[1], COARSE * size):
        raise MeshError(f"a surface to be made anew on a grid of {1000 * pitch:.2g} mm", "a smaller part, or a solid")
    inside, origin, volumes = _inside(mesh, pitch)
    distances = _distances(mesh, inside, origin, pitch)
    from skimage.measure import marching_cubes

    points, faces, _, _ = marching_cubes(distances, 0.0, gradient_direction="descent")
    body = manifold(origin + pitch * points, faces)
    if body.status() != m3.Error.NoError:
        raise MeshError(f"a distance field without a surface ({body.status().name})", "a solid")
    _replace(mesh, body.simplify(pitch / 4), pitch, float(np.median(volumes)))


def _replace(mesh: Checked, body: m3.Manifold, pitch: float, volume: float) -> None:
    """Take the new surface, and say how far it is off."""
    vertices, faces = arrays(body)
    change = abs(body.volume() - volume) / volume
    if change > LOST:
        raise MeshError(
            f"a surface that made anew holds {1e6 * body.volume():.3g} in place of {1e6 * volume:.3g} cm3", "a solid"
        )
    new = trimesh.Trimesh(vertices, faces, process=False)
    old = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    back = Nearest(mesh.vertices, mesh.faces).distances(trimesh.sample.sample_surface(new, SAMPLES, seed=1)[0])
    out = Nearest(vertices, faces).signed(trimesh.sample.sample_surface(old, SAMPLES, seed=1)[0])
    off = np.concatenate([back, np.maximum(out, 0.0)])  # what lies inside was left out with intent
    mesh.vertices, mesh.faces = vertices, faces
    mesh.moved, mesh.volume_change = max(mesh.moved, float(off.max())), mesh.volume_change + change
    mesh.notes.append(
        f"made the surface anew from its distance field on a grid of {1000 * pitch:.2g} mm: moved by "
        f"{1000 * np.percentile(off, 99):.2g} mm at most on 99 % of it and {1000 * off.max():.2g} mm on the rest, "
        f"the volume by {100 * change:.2g} %"
    )


def _least_pitch(points: Array) -> float:
    return float((np.prod(np.ptp(points, axis=0)) / MOST_POINTS) ** (1 / 3))


def _inside(mesh: Checked, pitch: float) -> tuple[np.ndarray, Array, Array]:
    """Which grid points (a, b, c) are inside, the first of them (3,) [m], and the volume (3,) [m3] by lines each way.

    Raises:
        MeshError: too many lines enter the surface more or less often than they leave it.
    """
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    # off the corners and edges of parts with round numbers
    origin = low - pitch * (2.0 + np.array([0.3183, 0.4142, 0.2361]))
    shape = tuple((np.ceil((high - origin) / pitch) + 3).astype(int).tolist())
    votes, told, volumes = np.zeros(shape, dtype=np.int8), np.zeros(shape, dtype=np.int8), []
    triangles = (mesh.vertices[mesh.faces] - origin) / pitch
    for axis in range(3):
        depth, good, length = _along(triangles, axis, shape)
        bad = (~good).sum() / max(int((depth != 0).any(axis=axis).sum()), 1)
        if bad > TORN:
            raise MeshError(
                f"{100 * bad:.0f} % of lines along {'xyz'[axis]} do not leave it as often as they enter", "a solid"
            )
        trusted = np.expand_dims(good, axis)
        votes += ((depth > 0) & trusted).astype(np.int8)
        told += np.broadcast_to(trusted, shape).astype(np.int8)
        volumes.append(length * pitch**3 * (1 + bad))
    doubtful = 2 * votes == told
    inside = 2 * votes > told
    if doubtful.any():  # as many for it as against: as most around
        around = ndimage.uniform_filter(inside.astype(np.float32), 5)
        inside = np.where(doubtful, around > 0.5, inside)
    return inside, origin, np.array(volumes)


def _along(triangles: Array, axis: int, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, float]:
    """Lines along an axis through a grid: depth (a, b, c) int8 at its points, which lines (two of a, b, c) leave as
    often as they enter, and the length inside of those, in grid widths."""
    u, v = [k for k in range(3) if k != axis]
    n_v, n = shape[v], shape[axis]
    starts = np.zeros((shape[u] * n_v, n + 1), dtype=np.int8)
    total = np.zeros(shape[u] * n_v, dtype=np.int32)
    for line, at, enters in _hits(triangles, axis, u, v, n_v):
        np.add.at(starts, (line, np.clip(np.ceil(at).astype(int), 0, n)), enters)
        np.add.at(total, line, enters)
    depth = np.cumsum(starts[:, :n], axis=1, dtype=np.int8)
    length = float((depth[total == 0] > 0).sum())
    good = (total == 0).reshape(shape[u], n_v)
    return np.moveaxis(depth.reshape(shape[u], n_v, n), 2, axis), good, length


def _hits(triangles: Array, axis: int, u: int, v: int, n_v: int) -> Iterator[tuple[np.ndarray, Array, np.ndarray]]:
    """Where lines go through triangles (m, 3, 3): line (k,), place along it (k,), +1 for into the solid, -1 for out."""
    flat = triangles[:, :, [u, v]]
    low = np.ceil(flat.min(axis=1)).astype(int)
    count = np.maximum(np.floor(flat.max(axis=1)).astype(int) - low + 1, 0)
    cells = count.prod(axis=1)
    a, b, c = (flat[:, k] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    # cross product of (u, v): the normal along `axis` has the sign of the area, but for the order of y
    sign = np.where(area > 0, -1, 1) * (-1 if axis == 1 else 1)
    cells[np.abs(area) < 1e-12] = 0
    order = np.flatnonzero(cells)
    for part in np.array_split(order, int(cells.sum() // CHUNK) + 1):
        which = np.repeat(part, cells[part])
        local = np.arange(len(which)) - np.repeat(np.cumsum(cells[part]) - cells[part], cells[part])
        p = low[which] + np.stack([local // count[which, 1], local % count[which, 1]], axis=1)
        pa, pb, pc = a[which] - p, b[which] - p, c[which] - p
        w = np.stack([_cross(pb, pc), _cross(pc, pa), _cross(pa, pb)], axis=1) / area[which][:, None]
        hit = (w > 0).all(axis=1)
        which, p = which[hit], p[hit]
        at = (w[hit] * triangles[which][:, :, axis]).sum(axis=1)
        yield p[:, 0] * n_v + p[:, 1], at, sign[which]


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _distances(mesh: Checked, inside: np.ndarray, origin: Array, pitch: float) -> Array:
    """Signed distances (a, b, c) in grid widths, negative inside, exact where a neighbour is on the other side."""
    field = np.where(inside, np.float32(-1.5), np.float32(1.5))
    border = ndimage.maximum_filter(inside, 3) != ndimage.minimum_filter(inside, 3)
    at = np.argwhere(border)
    near = Nearest(mesh.vertices, mesh.faces)
    parts = np.array_split(at, len(at) // 500_000 + 1)
    distances = np.concatenate([near.distances(origin + pitch * part) for part in parts])
    field[border] *= np.minimum(distances / pitch, 1.5).astype(np.float32) / 1.5
    return field
