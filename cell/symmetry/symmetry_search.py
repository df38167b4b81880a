"""The symmetry of a CAD mesh as the project records it, and the frame in which its axes are x, y and z.

d_x, d_y, d_z of the paper describe rotations about the axes of the part frame only. So the frame is chosen such that
they generate the largest group: the main axis becomes z, a perpendicular axis of order 2 becomes x. The full groups of
    a tetrahedron and an icosahedron cannot be expressed so; the result states what is missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
import trimesh

from pickproof.cell.frames import Array, about_axis, make_transform, rotation_angle
from pickproof.cell.symmetry.self_match import Match, SelfMatch
from pickproof.cell.symmetry.symmetry import Symmetry
from pickproof.cell.symmetry.symmetry_axes import ANY, Axis, find_axes, settled_axis

Degrees = tuple[float, float, float]
CONFUSING = 0.15
"""Share of the surface beyond the tolerance up to which a rotation counts as nearly a symmetry."""
CLOSE = 4.0
"""Residual, in tolerances, up to which a rotation counts as nearly a symmetry."""
NEAR_ORDERS = (0, 2, 3, 4, 6)
SNAP = np.deg2rad(0.3)
"""Angle between found axes and CAD axes up to which the CAD axes are used."""
OFF_AXIS = 2e-4
"""Distance of the bounding box's centre from an axis of symmetry, as a share of the longest side, that counts as 0."""
PARALLEL, UPRIGHT = np.cos(np.deg2rad(2.0)), np.sin(np.deg2rad(2.0))


@dataclass(frozen=True)
class NearTurn:
    """A rotation that is nearly a symmetry: axis (3,) in the part frame, order (0: any angle), how it fits."""

    direction: Array
    order: int
    match: Match


@dataclass(frozen=True)
class FoundSymmetry:
    """Result of the search.

    Attributes:
        degrees: d_x, d_y, d_z in [deg]; 5 for any turn.
        T_part_cad: (4, 4) that moves the mesh to the part's frame.
        match: of the claimed rotation that fits worst.
        tolerance: [m] below which a difference counts as none.
        near: rotations that are nearly symmetries, the closest first.
        missing: symmetry of the shape that d_x, d_y, d_z cannot express; empty where there is none.
    """

    degrees: Degrees
    T_part_cad: Array
    match: Match
    tolerance: float
    near: tuple[NearTurn, ...]
    missing: str


def find_symmetry(mesh: trimesh.Trimesh, tolerance: float) -> FoundSymmetry:
    """Symmetry of a closed mesh in [m].

    Args:
        tolerance: [m] difference that perception cannot detect.
    """
    centre = np.asarray(mesh.center_mass)
    shape = SelfMatch(mesh, centre, tolerance)
    axes = find_axes(shape, np.asarray(mesh.moment_inertia))
    R, degrees = _frame(axes)
    symmetry = Symmetry(degrees)
    match = max((axis.match for axis in axes), key=lambda m: m.residual, default=Match(0.0, 0.0))
    return FoundSymmetry(
        degrees=degrees,
        T_part_cad=_placed(mesh, R, centre, symmetry),
        match=match,
        tolerance=tolerance,
        near=_near(shape, axes, R, np.asarray(mesh.moment_inertia), symmetry),
        missing=_missing(axes, symmetry),
    )


def check_degrees(mesh: trimesh.Trimesh, degrees: Degrees, tolerance: float) -> Match:
    """How a closed mesh in the part frame fits a symmetry about the origin that the user states."""
    shape = SelfMatch(mesh, np.zeros(3), tolerance)
    # multiples of d even where d counts as infinite: a toothed part is no body of revolution
    steps = [about_axis(a, np.deg2rad(d * k)) for a, d in zip(np.eye(3), degrees, strict=True) if d for k in (1, 2, 5)]
    turns = [*(make_transform(R) for R in Symmetry(degrees).S), *steps]
    return max((shape.measure(T) for T in turns), key=lambda m: m.residual)


def _frame(axes: list[Axis]) -> tuple[Array, Degrees]:
    """R_part_cad (3, 3) and degrees of the frame with the largest group; among equals the one nearest to the CAD
    frame.
    """
    if not axes:
        return np.eye(3), (0.0, 0.0, 0.0)
    best: tuple[tuple[int, float], Array, Degrees] | None = None
    for main in axes:
        flat = [a.direction for a in axes if abs(a.direction @ main.direction) < UPRIGHT]
        for R in _rotations(main.direction, flat):
            degrees = tuple(next((a.degrees for a in axes if abs(a.direction @ w) > PARALLEL), 0.0) for w in R)
            try:
                symmetry = Symmetry(degrees)  # type: ignore[arg-type]
            except ValueError:  # these axes belong to a larger group than the degrees generate
                continue
            # x or y as the main axis is equivalent; the shipped workpieces have theirs along z
            upright = abs(R[2] @ main.direction) > PARALLEL and main.degrees == min(a.degrees for a in axes)
            rank = (symmetry.size, upright, -round(float(rotation_angle(R)), 3))
            if best is None or rank > best[0]:
                best = (rank, R, degrees)  # type: ignore[assignment]
    assert best is not None  # a single axis always generates a group
    return _snapped(best[1]), best[2]


def _rotations(main: Array, flat: list[Array]) -> list[Array]:
    """R_part_cad (3, 3) with z along an axis, x along one at right angles to it where there is one; either sign."""
    found = []
    for sign in (1, -1):
        z = sign * main
        others = [s * x for x in flat for s in (1, -1)] or _turned_least(z)
        for x in others:
            x = x - (x @ z) * z
            x /= np.linalg.norm(x)
            found.append(np.stack([x, np.cross(z, x), z]))
    return found


def _turned_least(z: Array) -> list[Array]:
    """x axes for a z axis: those of the CAD, flattened."""
    return [s * x for x in np.eye(3) for s in (1, -1) if abs(x @ z) < 0.8]


def _snapped(R: Array) -> Array:
    """The nearby rotation by right angles, if there is one."""
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        straight = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if np.linalg.det(straight) > 0 and rotation_angle(straight.T @ R) < SNAP:
            return straight
    return R


def _placed(mesh: trimesh.Trimesh, R: Array, centre: Array, symmetry: Symmetry) -> Array:
    """T_part_cad: the middle of the bounding box to the origin, or an axis of symmetry where that differs."""
    turned = mesh.vertices @ R.T
    middle = (turned.min(axis=0) + turned.max(axis=0)) / 2
    off = R @ centre - middle
    across = off - symmetry.fixed @ off
    if np.linalg.norm(across) > OFF_AXIS * float(np.ptp(turned, axis=0).max()):
        middle = middle + across
    return make_transform(R, -middle)


def _near(shape: SelfMatch, axes: list[Axis], R: Array, inertia: Array, symmetry: Symmetry) -> tuple[NearTurn, ...]:
    """Rotations about principal, CAD and found axes that are nearly symmetries, in the part frame."""
    directions: list[Array] = []
    for direction in [*(a.direction for a in axes), *np.eye(3), *np.linalg.eigh(inertia)[1].T]:
        if not any(abs(direction @ d) > PARALLEL for d in directions):
            directions.append(direction)
    own, found = symmetry.rotations(), []
    for direction, order in product(directions, NEAR_ORDERS):
        angle = ANY[0] if order == 0 else 2 * np.pi / order
        if _is_own(R @ about_axis(direction, np.array(angle))[:3, :3] @ R.T, own, symmetry, R @ direction, order):
            continue
        if shape.coarse(about_axis(direction, np.array(angle))) > CLOSE * shape.tolerance:
            continue
        settled = direction if order == 0 else settled_axis(shape, direction, order)
        if settled is None:
            continue
        match = _near_match(shape, settled, order)
        # otherwise it is a symmetry that d_x, d_y, d_z cannot express
        if match is not None and match.residual > shape.tolerance:
            found.append(NearTurn(R @ settled, order, match))
    found.sort(key=lambda n: (n.match.share, n.match.residual))
    kept: list[NearTurn] = []
    for turn in found:
        if not any(abs(turn.direction @ k.direction) > PARALLEL and _within(turn.order, k.order) for k in kept):
            kept.append(turn)
    return tuple(kept[:4])


def _is_own(turn: Array, own: Array, symmetry: Symmetry, direction: Array, order: int) -> bool:
    if symmetry.is_sphere:
        return True
    axis = symmetry.infinite_axis
    if axis is not None:
        turned_over = order == 2 and len(own) > 24 and abs(direction[axis]) < UPRIGHT
        return turned_over or abs(float(direction[axis])) > PARALLEL
    return order != 0 and bool((np.abs(own - turn).max(axis=(1, 2)) < 0.05).any())


def _near_match(shape: SelfMatch, direction: Array, order: int) -> Match | None:
    """The worst match over the rotations of an order; None where one of them is clearly no symmetry."""
    angles = ANY[:5] if order == 0 else [2 * np.pi / order * k for k in range(1, order // 2 + 1)]
    worst = Match(0.0, 0.0)
    for angle in angles:
        turn = about_axis(direction, np.array(angle))
        # the feature that breaks the symmetry moves the centre of mass and the axis; registration would undo any
        # rotation
        if order:
            turn = shape.settle(turn)
        match = shape.measure(turn)
        if match.residual > CLOSE * shape.tolerance and match.share > CONFUSING:
            return None
        worst = max(worst, match, key=lambda m: m.residual)
    return worst


def _within(order: int, other: int) -> bool:
    """Whether a rotation of this order is implied by one of the other order."""
    return other == 0 or (order != 0 and other % order == 0)


def _missing(axes: list[Axis], symmetry: Symmetry) -> str:
    """Axes whose rotations are not in the group."""
    if symmetry.is_sphere or symmetry.infinite_axis is not None:
        return ""
    orders = [axis.order for axis in axes]
    whole = {5: ("icosahedron", 60), 4: ("cube", 24), 3: ("tetrahedron", 12)}
    for order, (name, size) in whole.items():
        if orders.count(order) > 1 and symmetry.size < size:
            return (
                f"the shape has all {size} rotations of a {name}; d_x, d_y, d_z express {symmetry.size} of them; "
                "poses that differ by one of the others count as different"
            )
    return ""
