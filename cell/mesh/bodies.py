"""The bodies of a closed mesh: hollow ones, overlapping ones, ones inside out; made one, or offered one by one."""

from __future__ import annotations

import manifold3d as m3
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from pickproof.cell.frames import Array
from pickproof.cell.mesh.checked import Checked
from pickproof.cell.mesh.edges import faces_at_edges
from pickproof.cell.mesh.error import MeshError, TornError, near

CRUMB = 0.005
"""Bodies apart from the largest and below this share of its volume are left out."""
TINY = 1e-6
"""Of the largest body's volume, below which a surface encloses nothing."""
MANY = 500
LISTED = 8
LOST = 0.02
"""Share of the volume that repairs may change; more is for the designer to say."""


def split_touching(mesh: Checked) -> None:
    """Give each side a vertex of its own where a solid touches itself along an edge, so that two faces meet at each.

    Raises:
        TornError: the faces at such an edge do not bound solids.
    """
    edges, meeting = faces_at_edges(mesh.faces)
    crowded = edges[meeting > 2]
    if len(crowded) == 0:
        return
    where = near(mesh.vertices[crowded[0]])
    body = manifold(mesh.vertices, mesh.faces)
    if body.status() != m3.Error.NoError:
        raise TornError(
            f"{len(crowded)} edges with more than two faces, one {where}",
            "a surface on which two faces meet at every edge",
        )
    mesh.vertices, mesh.faces = arrays(body)
    mesh.notes.append(f"the surface touches itself along {len(crowded)} edges, one {where}: kept as it is")


def one_body(mesh: Checked, wanted: int | None = None) -> None:
    """Make a closed mesh with consistent faces one solid, cavities included.

    Args:
        wanted: which of bodies that do not touch is taken, 1 for the largest; None where there must be one.

    Raises:
        MeshError: its bodies do not touch, or `wanted` is not among them.
    """
    parts = [mesh.faces[label] for label in _components(mesh.faces, len(mesh.vertices))]
    volumes = np.array([_volume(mesh.vertices, part) for part in parts])
    outer = int(np.argmax(np.abs(volumes)))
    if volumes[outer] < 0:  # cavities are turned with it
        parts, volumes = [part[:, ::-1] for part in parts], -volumes
        mesh.notes.append("turned inside out: the normals looked inward")
    if volumes[outer] <= TINY * float(np.prod(np.ptp(mesh.vertices[parts[outer]].reshape(-1, 3), axis=0))):
        raise MeshError("a surface that encloses nothing", "a solid")
    if len(parts) > 1:
        mesh.vertices, mesh.faces = _joined(mesh, parts, volumes, wanted)
    else:
        _check_wanted(wanted, 1)
        mesh.faces = parts[0]


def _joined(mesh: Checked, parts: list[np.ndarray], volumes: Array, wanted: int | None) -> tuple[Array, np.ndarray]:
    kept = np.abs(volumes) > TINY * volumes.max()
    solids = [_solid(mesh.vertices, part) for part, keep in zip(parts, kept & (volumes > 0), strict=True) if keep]
    negative = [_solid(mesh.vertices, part[:, ::-1])
                for part, keep in zip(parts, kept & (volumes < 0), strict=True) if keep]  # fmt: skip
    whole = m3.Manifold.batch_boolean(solids, m3.OpType.Add)
    cavities = [body for body in negative if (body ^ whole).volume() > 0.5 * body.volume()]
    turned = [body for body in negative if (body ^ whole).volume() <= 0.5 * body.volume()]
    if turned:
        mesh.notes.append(f"turned {len(turned)} bodies whose normals looked inward")
        whole, solids = m3.Manifold.batch_boolean([whole, *turned], m3.OpType.Add), solids + turned
    pieces = whole.decompose()  # of negative volume: what the bodies enclose together
    apart = sorted((b for b in pieces if b.volume() > TINY * volumes.max()), key=lambda b: -b.volume())
    large = [body for body in apart if body.volume() > CRUMB * apart[0].volume()]
    left = sum(body.volume() for body in apart[len(large) :])
    share = left / whole.volume()
    if len(large) > 1 and wanted is None:
        found = f"{len(large)} bodies that do not touch, or at an edge only: {_listed(large)}"
        raise MeshError(found, "one solid; --body N takes one of them")
    _check_wanted(wanted, len(large))
    chosen = large[(wanted or 1) - 1]
    if any(body.volume() < -TINY * volumes.max() for body in pieces):
        chosen = chosen ^ whole
    if len(large) > 1:
        mesh.notes.append(f"took body {wanted or 1} of {len(large)}: {_told(chosen)}")
    elif left:
        if share > LOST:
            found = f"{len(apart) - 1} small bodies that do not touch the largest, one of {_told(apart[1])}"
            raise MeshError(
                f"{found}, with {100 * share:.1f} % of the volume",
                f"one solid, with {100 * LOST:g} % in loose bodies at most; join them in the CAD",
            )
        mesh.volume_change += share
        mesh.notes.append(
            f"left out {len(apart) - 1} bodies below {100 * CRUMB:g} % of the volume, {100 * share:.2g} % in all"
        )
    if len(solids) > len(apart):
        twice = sum(body.volume() for body in solids) - whole.volume()
        mesh.notes.append(
            f"joined {len(solids)} bodies that overlap or touch"
            + (f"; {1e6 * twice:.3g} cm3 was in two of them" if twice > 1e-3 * whole.volume() else "")
        )
    return _hollowed(mesh, chosen, cavities)


def _hollowed(mesh: Checked, chosen: m3.Manifold, cavities: list[m3.Manifold]) -> tuple[Array, np.ndarray]:
    """The chosen body without the cavities (of all bodies) that lie in it; those that a union left, it has already."""
    own = [cavity for cavity in cavities if (cavity ^ chosen).volume() > 0.5 * cavity.volume()]
    if own:
        chosen = m3.Manifold.batch_boolean([chosen, *own], m3.OpType.Subtract)
        mesh.notes.append(f"kept {len(own)} closed cavities, {1e6 * sum(c.volume() for c in own):.3g} cm3")
    return arrays(chosen)


def _check_wanted(wanted: int | None, bodies: int) -> None:
    if wanted is not None and not 1 <= wanted <= bodies:
        valid = f"1 to {bodies}, the largest first" if bodies > 1 else "1: there is one body"
        raise MeshError(f"--body {wanted}", valid)


def _components(faces: np.ndarray, n: int) -> list[np.ndarray]:
    a, b, c = faces.T
    links = coo_matrix((np.ones(2 * len(a)), (np.concatenate([a, b]), np.concatenate([b, c]))), shape=(n, n))
    _, label = connected_components(links, directed=False)
    of_face = label[a]
    kinds = np.flatnonzero(np.bincount(of_face))
    if len(kinds) > MANY:
        raise MeshError(f"{len(kinds)} bodies", f"at most {MANY}; export each part by itself")
    return [of_face == k for k in kinds]


def _volume(vertices: Array, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, k]] - vertices[faces[0, 0]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _solid(vertices: Array, faces: np.ndarray) -> m3.Manifold:
    used, local = np.unique(faces, return_inverse=True)
    body = manifold(vertices[used], local.reshape(-1, 3))
    if body.status() != m3.Error.NoError:
        raise TornError(
            f"a surface that is no solid ({body.status().name}) {near(vertices[used])}",
            "a closed surface with outward normals",
        )
    return body


def manifold(vertices: Array, faces: np.ndarray) -> m3.Manifold:
    """A solid of the library of that name, with a status that says what is wrong."""
    return m3.Manifold(m3.Mesh64(np.array(vertices, np.float64, order="C"), np.array(faces, np.uint64, order="C")))


def arrays(body: m3.Manifold) -> tuple[Array, np.ndarray]:
    """Vertices (n, 3) and faces (m, 3) of a solid."""
    made = body.to_mesh64()
    return np.array(made.vert_properties[:, :3], np.float64), np.array(made.tri_verts, np.int64)


def _listed(bodies: list[m3.Manifold]) -> str:
    shown = [f"{i}: {_told(body)}" for i, body in enumerate(bodies[:LISTED], 1)]
    return "; ".join(shown + ([f"and {len(bodies) - LISTED} more"] if len(bodies) > LISTED else []))


def _told(body: m3.Manifold) -> str:
    """Size, place and volume in words."""
    low, high = np.split(np.asarray(body.bounding_box()), 2)
    size = " x ".join(f"{1000 * s:.3g}" for s in high - low)
    return f"{size} mm {near((low + high) / 2)}, {1e6 * body.volume():.3g} cm3"
