"""Grasp proposals for a parallel jaw on freeform workpieces, which have no parallel faces.

On a curved surface each pad touches the outermost points between the pads. So the closing of the pads is computed for
every approach about a closing direction, and a grasp is proposed if the normals at both contacts are opposed closely
enough to hold by friction.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np

from pickproof.cell.frames import Array, about_axis, apply, invert, make_transform
from pickproof.cell.grippers.parallel_jaw import ParallelJaw
from pickproof.cell.workpiece.resting_poses import resting_poses
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.grasp_points import OPENING_MARGIN, GraspPoint, Turn

CONE = float(np.cos(np.deg2rad(20.0)))  # largest angle at each contact; friction of 0.4 holds up to 22 degrees
TOUCH = 0.0004  # [m] distance from the outermost point within which the surface touches a pad
FLANK = 0.7
"""Cosine of the angle from which the surface near the outermost point is the side of a tooth or step, without
contact.
"""
BESIDE = 0.003  # [m] largest offset of the two contacts across the closing direction: more would rotate the workpiece
INTO = 1e-4  # [m] that the gripper may go into the workpiece, for the sampling of its surface
STEP_DEG = 30.0
ARC_DEG, MOST_DEG = 15.0, 45.0
"""Step and largest angle by which the approach may rotate about its closing direction with the same grip."""
DEPTH = 0.006  # [m] of the tips past the middle of the grip
MAX_TILT_DEG = 60.0  # each has few approaches, so a larger tilt is allowed
DIRECTIONS, SAMPLES = 500, 6000
ABOVE_DEG, CENTRES = 5.0, 4
"""Step between closing directions of grips from above, and the number of centres tried for each."""


def freeform_proposals(workpiece: Workpiece, gripper: ParallelJaw, rng: np.random.Generator) -> Iterator[GraspPoint]:
    """Grasps across the workpiece near its centre of mass.

    First grasps from straight above the workpiece in its resting poses, likeliest pose first, then grasps from all
    directions; within each group, those with the best opposed contacts first.
    """
    points, normals = workpiece.sample_surface(SAMPLES, seed=int(rng.integers(2**31)))
    for grips in chain(_from_above(workpiece, rng), [_from_anywhere(workpiece, rng)]):
        found = [closed for T in grips if (closed := _close(T, gripper, points, normals)) is not None]
        for _, T_part_grip, width in sorted(found, key=lambda row: -row[0]):
            plain = [[round(float(x), 6) + 0.0 for x in v] for v in T_part_grip[:3, [3, 2, 0]].T]
            low, high, width = _arc(T_part_grip, width, gripper, points, normals)
            yield GraspPoint.model_validate(
                {"name": "proposed", "centre": plain[0], "approach": plain[1], "closing": plain[2], "width": width}
                | {"depths": (DEPTH,), "max_tilt_deg": MAX_TILT_DEG}
                | {"tool_rotation": Turn(from_deg=low, to_deg=high, step_deg=ARC_DEG)}
            )


def _from_above(workpiece: Workpiece, rng: np.random.Generator) -> Iterator[Iterator[Array]]:
    """For each resting pose, downward poses T_part_grip (4, 4) at the centre of mass and near it."""
    offsets = [np.zeros(3), *(_beside(workpiece, rng) for _ in range(CENTRES - 1))]
    for resting in resting_poses(workpiece.mesh, workpiece.symmetry):
        x, y, up = resting.T_plane_part[:3, :3]
        closings = [np.cos(a) * x + np.sin(a) * y for a in np.deg2rad(np.arange(0.0, 180.0, ABOVE_DEG))]
        yield (_grip(closing, -up, workpiece, off) for off in offsets for closing in closings)


def _from_anywhere(workpiece: Workpiece, rng: np.random.Generator) -> Iterator[Array]:
    turns = about_axis((1, 0, 0), np.deg2rad(np.arange(0.0, 360.0, STEP_DEG)))
    for _ in range(DIRECTIONS):
        closing, approach = np.linalg.qr(rng.standard_normal((3, 2)))[0].T
        yield from _grip(closing, approach, workpiece, _beside(workpiece, rng)) @ turns


def _beside(workpiece: Workpiece, rng: np.random.Generator) -> Array:
    return rng.uniform(-0.15, 0.15, 3) * workpiece.extents


def _grip(closing: Array, approach: Array, workpiece: Workpiece, beside: Array) -> Array:
    """T_part_grip (4, 4) beside the centre of mass."""
    return make_transform(np.stack([closing, np.cross(approach, closing), approach], axis=1), workpiece.com + beside)


def _arc(
    T_part_grip: Array, width: float, gripper: ParallelJaw, points: Array, normals: Array
) -> tuple[float, float, float]:
    """Angle [deg] by which the approach may rotate about the closing direction in each sense, and the largest width
    [m].
    """
    ends = []
    for side in (-1, 1):
        reached = 0.0
        for angle in np.arange(ARC_DEG, MOST_DEG + 1e-6, ARC_DEG):
            turn = about_axis((1, 0, 0), np.deg2rad(side * angle))
            closed = _close(T_part_grip @ turn, gripper, points, normals)
            if closed is None or np.linalg.norm(closed[1][:3, 3] - T_part_grip[:3, 3]) > BESIDE / 2:
                break
            reached, width = float(angle), max(width, closed[2])
        ends.append(side * reached)
    return ends[0], ends[1], width


def _close(
    T_part_grip: Array, gripper: ParallelJaw, points: Array, normals: Array
) -> tuple[float, Array, float] | None:
    """How well the contacts are opposed, the grip moved to their middle, and the width; or None."""
    _, pad_width, pad_length = gripper.finger_size
    T = T_part_grip @ make_transform(t=(0.0, 0.0, DEPTH))
    p, n = apply(invert(T), points), normals @ T[:3, :3]
    on_pad = (np.abs(p[:, 1]) < pad_width / 2) & (p[:, 2] < 0) & (p[:, 2] > -pad_length)
    if np.count_nonzero(on_pad) < 10:
        return None
    p_on, n_on = p[on_pad], n[on_pad]
    places, straight = [], 1.0
    for side in (-1.0, 1.0):
        out = side * p_on[:, 0]
        touching = (out > out.max() - TOUCH) & (side * n_on[:, 0] > FLANK)
        if not touching.any():
            return None
        places.append(p_on[touching].mean(axis=0))
        straight = min(straight, float((side * n_on[touching, 0]).mean()))
    width = float(np.ptp(p_on[:, 0])) + 2 * INTO
    beside = float(np.linalg.norm((places[1] - places[0])[1:]))
    if straight < CONE or beside > BESIDE or width > gripper.max_opening - 2 * OPENING_MARGIN:
        return None
    middle = float(p_on[:, 0].max() + p_on[:, 0].min()) / 2
    p = p - (middle, 0.0, 0.0)
    for box in [*gripper.boxes(width + 2 * OPENING_MARGIN), *gripper.finger_boxes(width)]:
        if (np.asarray(box.size) / 2 - np.abs(p - box.T_world_box[:3, 3])).min(axis=1).max() > INTO:
            return None
    return straight, T_part_grip @ make_transform(t=(middle, 0.0, 0.0)), round(width, 5)
