"""Grasp proposals from the CAD: two opposed faces for a parallel jaw, or a place where a cup seals.

Antipodal sampling as in Nguyen, "Constructing force-closure grasps" (1988): from a point of the surface a ray goes
through the material; where it leaves through an opposed face, two pads pressed on both ends hold by friction alone.
`scenarios.grasp_trials.trial` tests the proposals in the physics.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, about_axis, apply, invert, make_transform
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.one_sided import OneSidedGripper
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.grasp_points import OPENING_MARGIN, GraspPoint, Turn
from pickproof.grasping.sample_freeform import freeform_proposals
from pickproof.grasping.sample_one_sided import one_sided_proposals

STEP_DEG = 15.0  # step between approaches about the closing direction
RAYS = 4000
OPPOSED = float(np.cos(np.deg2rad(8.0)))  # largest angle between the two faces, well inside the friction cone
DEPTH = 0.004  # [m] of the tips past the line between the contacts
TOUCH = 3e-4  # [m] distance within which the surface touches a pad
FACING = 0.95  # cosine of the largest angle at which the surface still supports a pad
LEAST_AREA = 30e-6  # [m2] smallest contact area of each pad
FREEFORM = (float(np.cos(np.deg2rad(15.0))), 6e-6)
"""The same limits for curved faces: inside the cone of friction 0.3, and the area of a ball of 10 mm radius that
touches a pad within TOUCH.
"""
INTO = 5e-5  # [m] allowed penetration of the workpiece, because its surface is sampled
SPACING = 0.010  # [m] smallest distance between proposals with the same direction
TRIED = 40
"""Number of contact pairs that are checked, nearest to the centre of mass first, each well apart from the others."""


@dataclass(frozen=True)
class _Surface:
    """Surface samples of the workpiece: points and outward normals (n, 3), and the area [m2] of one sample."""

    points: Array
    normals: Array
    area: float

    @staticmethod
    def of(workpiece: Workpiece) -> _Surface:
        n = int(np.clip(workpiece.mesh.area / 2e-6, 3000, 12_000))
        points, normals = workpiece.sample_surface(n, seed=5)
        return _Surface(points, normals, float(workpiece.mesh.area) / n)


def propose(workpiece: Workpiece, gripper: Gripper, count: int, rng: np.random.Generator) -> list[GraspPoint]:
    """At most `count` distinct grasp points for a gripper, nearest to the centre of mass first.

    One function proposes for each kind of gripper: `jaw_proposals` and then `freeform_proposals`, which finds what
    teeth and curved faces allow, or `one_sided_proposals` for cups and magnets.

    Raises:
        InputError: another kind of gripper.
    """
    kind, alike = ("jaw", _alike) if isinstance(gripper, ParallelJaw) else ("face", _beside)
    proposals: Iterator[GraspPoint]
    if isinstance(gripper, ParallelJaw):
        proposals = chain(jaw_proposals(workpiece, gripper, rng), freeform_proposals(workpiece, gripper, rng))
    elif isinstance(gripper, OneSidedGripper):
        proposals = one_sided_proposals(workpiece, gripper, rng)
    else:
        raise InputError("command line", "--gripper", gripper.name, "a parallel jaw, cups or magnets")
    found: list[GraspPoint] = []
    for point in proposals:
        if not any(alike(point, other, workpiece) for other in found):
            name = f"{kind}_{len(found) + 1}"
            found.append(point.model_copy(update={"name": name}))
        if len(found) >= count:
            break
    return found


def jaw_proposals(workpiece: Workpiece, gripper: ParallelJaw, rng: np.random.Generator) -> Iterator[GraspPoint]:
    """Antipodal grasps of a parallel jaw, each with the range of approaches in which the gripper has clearance.

    Grasps with large parallel faces under the pads come first, then those with less parallel or curved faces.
    """
    seed = int(rng.integers(2**31))
    for opposed, area in ((OPPOSED, LEAST_AREA), FREEFORM):
        yield from _jaw_proposals(workpiece, gripper, seed, opposed, area)


def _jaw_proposals(
    workpiece: Workpiece, gripper: ParallelJaw, seed: int, opposed: float, least_area: float
) -> Iterator[GraspPoint]:
    surface = _Surface.of(workpiece)
    centres, closings, widths = _antipodal(workpiece, gripper.max_opening - 2 * OPENING_MARGIN, seed, opposed)
    order = _apart(centres, closings, workpiece)
    for centre, closing, width in zip(centres[order], closings[order], widths[order], strict=True):
        free = _free_approaches(centre, closing, float(width), gripper, surface, least_area)
        for start, n in _arcs(free):
            middle = start + (n - 1) // 2
            below, above = (n - 1) // 2, n - 1 - (n - 1) // 2
            if n == len(free):
                below, above = n // 2, n - 1 - n // 2
            yield _point(centre, closing, float(width), middle * STEP_DEG, (-below * STEP_DEG, above * STEP_DEG))


def _antipodal(workpiece: Workpiece, widest: float, seed: int, opposed: float) -> tuple[Array, Array, Array]:
    """Middles (n, 3), directions (n, 3) and distances (n,) [m] of opposed contacts at most `widest` apart."""
    points, normals = workpiece.sample_surface(RAYS, seed=seed)
    mesh = workpiece.mesh
    hits, ray, face = mesh.ray.intersects_location(points - 1e-6 * normals, -normals, multiple_hits=True)
    width = np.linalg.norm(hits - points[ray], axis=1)
    leaves = np.einsum("ij,ij->i", mesh.face_normals[face], -normals[ray]) > opposed
    good = leaves & (width < widest) & (width > 1e-3)
    ray, hits, width = ray[good], hits[good], width[good]
    return (points[ray] + hits) / 2, -normals[ray], width


def _apart(centres: Array, closings: Array, workpiece: Workpiece) -> list[int]:
    """Pairs of contacts, nearest to the centre of mass first, none equal or symmetric to another one."""
    rotations = workpiece.symmetry.rotations()
    kept: list[int] = []
    images, directions = np.zeros((0, 3)), np.zeros((0, 3))
    for i in np.argsort(np.linalg.norm(centres - workpiece.com, axis=1), kind="stable"):
        near = np.linalg.norm(images - centres[i], axis=1) < SPACING / 2
        if not (near & (np.abs(directions @ closings[i]) > OPPOSED)).any():
            kept.append(int(i))
            images = np.concatenate([images, rotations @ centres[i]])
            directions = np.concatenate([directions, rotations @ closings[i]])
        if len(kept) >= TRIED:
            break
    return kept


def _free_approaches(
    centre: Array, closing: Array, width: float, gripper: ParallelJaw, surface: _Surface, least_area: float
) -> np.ndarray:
    """(24,) bool: approaches at multiples of STEP_DEG with clearance and enough contact area on both pads."""
    Ts_tool_part = invert(_tool_poses(centre, closing))
    fingers, length = gripper.finger_size, gripper.finger_size[2]
    reach = float(np.linalg.norm(gripper.boxes(gripper.max_opening)[0].T_world_box[:3, 3])) + 0.1
    near = np.linalg.norm(surface.points - centre, axis=1) < reach
    p = apply(Ts_tool_part, surface.points[near])
    n = surface.normals[near] @ np.swapaxes(Ts_tool_part[:, :3, :3], -1, -2)
    free = np.ones(len(p), dtype=bool)
    for box in [*gripper.boxes(width + 2 * OPENING_MARGIN), *gripper.finger_boxes(width)]:
        depth = (np.asarray(box.size) / 2 - np.abs(p - box.T_world_box[:3, 3])).min(axis=-1)
        free &= depth.max(axis=1) < INTO
    on_pad = (np.abs(p[..., 1]) < fingers[1] / 2) & (p[..., 2] < 0) & (p[..., 2] > -length)
    for side in (-1, 1):
        touching = on_pad & (np.abs(p[..., 0] - side * width / 2) < TOUCH) & (n[..., 0] * side > FACING)
        free &= touching.sum(axis=1) * surface.area > least_area
    return free


def _tool_poses(centre: Array, closing: Array) -> Array:
    """Ts_part_tool (24, 4, 4) at multiples of STEP_DEG about the closing direction."""
    turns = about_axis((1, 0, 0), np.deg2rad(np.arange(0.0, 360.0, STEP_DEG)))
    return make_transform(_frame(closing), centre) @ turns @ make_transform(t=(0.0, 0.0, DEPTH))


def _frame(closing: Array) -> Array:
    """R_part_tool (3, 3) with x along `closing` and z along the CAD axis that is most at right angles to it."""
    axis = np.eye(3)[int(np.argmin(np.abs(closing)))]
    z = axis - (axis @ closing) * closing
    z /= np.linalg.norm(z)
    return np.stack([closing, np.cross(z, closing), z], axis=1)


def _arcs(free: np.ndarray) -> list[tuple[int, int]]:
    """Runs of free approaches round the circle: start and length."""
    n = len(free)
    if free.all():
        return [(0, n)]
    starts = [i for i in range(n) if free[i] and not free[i - 1]]
    return [(i, next(k for k in range(1, n) if not free[(i + k) % n])) for i in starts]


def _point(centre: Array, closing: Array, width: float, angle_deg: float, turn: tuple[float, float]) -> GraspPoint:
    approach = make_transform(_frame(closing)) @ about_axis((1, 0, 0), np.deg2rad(angle_deg))
    plain = [[round(float(x), 6) + 0.0 for x in v] for v in (centre, approach[:3, 2], closing)]
    return GraspPoint.model_validate(
        {
            "name": "proposed",
            "centre": plain[0],
            "approach": plain[1],
            "closing": plain[2],
            "width": round(width, 5),
            "depths": (DEPTH,),
            "tool_rotation": Turn(from_deg=turn[0], to_deg=turn[1], step_deg=STEP_DEG),
        }
    )


def _alike(a: GraspPoint, b: GraspPoint, workpiece: Workpiece) -> bool:
    """Whether both grip nearly the same spot from the same side, symmetry considered.

    A single approach excludes fewer neighbours than an arc of approaches.
    """
    same_side = 0.5 if a.tool_rotation != Turn() else 0.85
    S = workpiece.symmetry.rotations()
    near = np.linalg.norm(S @ np.asarray(a.centre) - b.centre, axis=1) < SPACING
    along = np.abs((S @ np.asarray(a.closing)) @ np.asarray(b.closing)) > 0.9
    return bool((near & along & ((S @ np.asarray(a.approach)) @ np.asarray(b.approach) > same_side)).any())


def _beside(a: GraspPoint, b: GraspPoint, workpiece: Workpiece) -> bool:
    """Whether both lie on nearly the same spot of the same side, symmetry considered."""
    S = workpiece.symmetry.rotations()
    near = np.linalg.norm(S @ np.asarray(a.centre) - b.centre, axis=1) < SPACING
    return bool((near & ((S @ np.asarray(a.approach)) @ np.asarray(b.approach) > 0.9)).any())
