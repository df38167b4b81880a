"""Axes of rotational symmetry of a shape, found from the mesh alone.

An axis of symmetry goes through the centre of mass and is a principal axis of inertia. Where two or three principal
moments are equal, directions in that plane, or all directions, are tried, and the best are refined by registration of
the shape to itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pickproof.cell.frames import Array, about_axis
from pickproof.cell.symmetry.self_match import Match, SelfMatch

ALIKE = 0.04
"""Difference of two principal moments, as a share of the largest, up to which they count as equal."""
ALL, FEW, HALF = tuple(range(60, 1, -1)), (5, 4, 3, 2), (2,)
"""Orders of symmetry that are searched, highest first; a higher order counts as infinite."""
ANY = np.pi * (3 - np.sqrt(5)) * np.arange(1, 9)
"""[rad] Rotations by multiples of the golden angle, which belong to no finite order."""
LOOSE = 3.0
"""Coarse distance, in tolerances, up to which an exact check follows."""
SAME = np.cos(np.deg2rad(4.0))
SCAN_PLANE, SCAN_SPHERE, KEPT = 90, 500, 8


@dataclass(frozen=True)
class Axis:
    """An axis of symmetry through the shape's centre: unit direction (3,), order (0: any turn), how well it holds."""

    direction: Array
    order: int
    match: Match

    @property
    def degrees(self) -> float:
        """d of `Symmetry` in [deg]; 5 means any rotation, since it is finer than T_s."""
        return 360.0 / self.order if self.order else 5.0


def find_axes(shape: SelfMatch, inertia: Array) -> list[Axis]:
    """All axes of symmetry within the shape's tolerance; a ball has one axis of order 0 with arbitrary direction.

    Args:
        inertia: (3, 3) about the centre of mass, of any density.
    """
    moments, principal = np.linalg.eigh(inertia)
    near = np.diff(moments) < ALIKE * moments[-1]
    if near.all():
        if _any_turn(shape, np.eye(3)):
            worst = [shape.measure(about_axis(a, np.array(t))) for a, t in zip(np.eye(3), ANY[:3], strict=True)]
            return [Axis(a, 0, max(worst, key=lambda m: m.residual)) for a in np.eye(3)]
        directions = [*((d, ALL) for d in [*principal.T, *np.eye(3)]), *((d, FEW) for d in _scan_sphere(shape))]
    elif near.any():  # a perpendicular axis of order above 2 would make all moments equal
        lone = principal[:, 2 if near[0] else 0]
        directions = [(lone, ALL), *((d, HALF) for d in [*_scan_plane(shape, lone), *principal.T])]
    else:
        directions = [(d, HALF) for d in principal.T]
    found: list[Axis] = []
    for direction, orders in directions:
        if not any(abs(direction @ axis.direction) > SAME for axis in found):
            axis = axis_at(shape, direction, orders)
            if axis is not None and not any(abs(axis.direction @ other.direction) > SAME for other in found):
                found.append(axis)
    return found


def axis_at(shape: SelfMatch, direction: Array, orders: tuple[int, ...]) -> Axis | None:
    """The first order that fits about a direction (3,), with the direction refined; any rotation is tried first."""
    if orders == ALL and _any_turn(shape, direction[None]):
        worst = max((shape.measure(about_axis(direction, t)) for t in ANY), key=lambda m: m.residual)
        if worst.residual <= shape.tolerance:
            return Axis(direction, 0, worst)
    for order in orders:
        turns = (about_axis(direction, 2 * np.pi * k / np.array(order)) for k in range(1, order // 2 + 1))
        if any(shape.coarse_worst(T) > LOOSE * shape.tolerance for T in turns):
            continue
        for axis in _tries(shape, direction, order):
            match = order_match(shape, axis, order)
            if match.residual <= shape.tolerance:
                return Axis(axis, order, match)
    return None


def _tries(shape: SelfMatch, direction: Array, order: int) -> list[Array]:
    """Directions (3,) near the given one: the nearby CAD axis, itself, and the result of registration."""
    nearest = np.eye(3)[int(np.argmax(np.abs(direction)))] * np.sign(direction[np.argmax(np.abs(direction))])
    settled = settled_axis(shape, direction, order)
    return [*([nearest] if nearest @ direction > SAME else []), direction, *([] if settled is None else [settled])]


def settled_axis(shape: SelfMatch, direction: Array, order: int) -> Array | None:
    """The direction (3,) of the turn by one step of an order after registration; None where it converged to another
    one.
    """
    T = shape.settle(about_axis(direction, np.array(2 * np.pi / order)))
    turn = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    angle = float(np.linalg.norm(turn))
    if angle < 1e-3:
        return None
    axis = turn / angle
    axis = axis if axis @ direction > 0 else -axis
    stays = axis @ direction > SAME and abs(angle - 2 * np.pi / order) < 0.2 * 2 * np.pi / order
    return axis if stays else None


def order_match(shape: SelfMatch, direction: Array, order: int) -> Match:
    """The worst match over all rotations of an order (inverses fit equally); stops at the first that fails."""
    worst = Match(0.0, 0.0)
    for k in range(1, order // 2 + 1):
        T = about_axis(direction, np.array(2 * np.pi * k / order))
        if shape.coarse_worst(T) > 2 * shape.tolerance:
            return Match(shape.coarse_worst(T), 1.0)
        match = shape.measure(T)
        worst = max(worst, match, key=lambda m: m.residual)
        if worst.residual > shape.tolerance:
            break
    return worst


def _any_turn(shape: SelfMatch, directions: Array) -> bool:
    turns = (about_axis(a, t) for a in directions for t in ANY[:4])
    return all(shape.coarse_worst(T) <= shape.tolerance for T in turns)


def _scan_plane(shape: SelfMatch, lone: Array) -> list[Array]:
    """Directions at right angles to an axis, about which half a turn fits best."""
    u = np.cross(lone, np.eye(3)[int(np.argmin(np.abs(lone)))])
    u /= np.linalg.norm(u)
    v = np.cross(lone, u)
    angles = np.arange(SCAN_PLANE) * np.pi / SCAN_PLANE
    directions = np.cos(angles)[:, None] * u + np.sin(angles)[:, None] * v
    off = np.array([shape.coarse(about_axis(d, np.array(np.pi))) for d in directions])
    dips = np.flatnonzero((off <= np.roll(off, 1)) & (off <= np.roll(off, -1)))
    best = dips[np.argsort(off[dips], kind="stable")][:KEPT]
    return [_settled(shape, directions[i], 2) for i in best]


def _scan_sphere(shape: SelfMatch) -> list[Array]:
    """Directions about which half, a third or a quarter turn fits best."""
    i = np.arange(SCAN_SPHERE) + 0.5
    z = i / SCAN_SPHERE
    r, turn = np.sqrt(1 - z**2), ANY[0] * i
    directions = np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
    found = []
    for order in (2, 3, 4, 5):
        off = np.array([shape.coarse(about_axis(d, np.array(2 * np.pi / order))) for d in directions])
        taken: list[int] = []
        for k in np.argsort(off):
            if all(abs(directions[k] @ directions[j]) < np.cos(np.deg2rad(12.0)) for j in taken):
                taken.append(int(k))
            if len(taken) >= 2 * KEPT:
                break
        found += [_settled(shape, directions[k], order) for k in taken]
    return found


def _settled(shape: SelfMatch, direction: Array, order: int) -> Array:
    settled = settled_axis(shape, direction, order)
    return direction if settled is None else settled
