"""Proposals from the CAD for cups and magnets: where their faces hold by the same rule as in the physics.

A face is laid on the surface along its normal, levelled to what its rim meets, and asked what it holds there
(`OneSidedGripper.take`). What counts then is how much of its limits the weight takes, lifted straight up with an
acceleration: a place over the centre of mass bends the lip least.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pickproof.cell.frames import Array, about_axis, make_transform
from pickproof.cell.grippers.one_sided import OneSidedGripper, ring
from pickproof.cell.grippers.one_sided_hold import share
from pickproof.cell.grippers.vacuum import VacuumGripper
from pickproof.cell.physics.contact_probe import probe_part
from pickproof.cell.physics.world import GRAVITY
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.grasp_points import GraspPoint, Turn

SPOTS = 1500  # number of surface points that are tried
PRESS = 0.002  # [m] spring compression of the faces: compensates an error of the pose along the normal
PRESS_ALONE = 0.4  # share of the stroke, where each face has its own spring: a row of faces meets a tilted surface
TURN_DEG = 30.0  # step between rotations of several faces about the approach
LIFTED = 12.0  # [m/s2] acceleration upwards and sideways under which a place must hold
LEVELLED = 2  # number of alignments of the faces with the points under the rim


def one_sided_proposals(
    workpiece: Workpiece, gripper: OneSidedGripper, rng: np.random.Generator
) -> Iterator[GraspPoint]:
    """Places for the faces of a cup or magnet gripper, those that take least of its limits first."""
    over, up = over_centre_of_mass(workpiece, np.pi * gripper.radius**2)
    points, normals = workpiece.sample_surface(SPOTS, seed=int(rng.integers(2**31)))
    points, normals = np.concatenate([over, points]), np.concatenate([up, normals])
    turns = np.arange(0.0, 180.0, TURN_DEG) if len(gripper.centres) > 1 else np.zeros(1)
    found: list[tuple[float, Array]] = []
    for point, normal in zip(points, normals, strict=True):
        for turn in np.deg2rad(turns):
            T_part_tool = _level(workpiece, gripper, _laid(point, normal) @ about_axis((0, 0, 1), turn))
            use = worst_use(workpiece, gripper, T_part_tool)
            if use < 1.0:
                found.append((use, T_part_tool))
    for _, T_part_tool in sorted(found, key=lambda row: row[0]):
        yield _point(T_part_tool, gripper)


def over_centre_of_mass(workpiece: Workpiece, area: float) -> tuple[Array, Array]:
    """Points and outward normals, each (n, 3), over the centre of mass in the planes of faces of `area` [m2] or more.

    Such places bend the faces least. They need not be on the surface: between the slots of a rail few places have room
    for ten cups, and random points miss them.
    """
    mesh = workpiece.mesh
    flat = [facet[0] for facet, size in zip(mesh.facets, mesh.facets_area, strict=True) if size >= area]
    normals = mesh.face_normals[flat].reshape(-1, 3)
    heights = np.einsum("ij,ij->i", mesh.triangles[flat].reshape(-1, 3, 3)[:, 0] - workpiece.com, normals)
    return workpiece.com + heights[:, None] * normals, normals


def worst_use(workpiece: Workpiece, gripper: OneSidedGripper, T_part_tool: Array) -> float:
    """Largest share of any limit of any face that the workpiece takes when lifted along tool -z; infinite if not held.

    Load at the centre of mass: weight and LIFTED along the tool axis, LIFTED across it in the worst of eight
        directions. They are 45 degrees apart, as the rotations of a single face are, so all these see the same loads.
    """
    holds, reasons = gripper.take(lambda xy: probe_part(workpiece, T_part_tool, xy), lambda _: workpiece.magnetic)
    if any(reasons) or not holds:
        return np.inf
    lever = T_part_tool[:3, :3].T @ (workpiece.com - T_part_tool[:3, 3])
    worst = 0.0
    for across in ring(LIFTED, 8):
        force = workpiece.mass * np.array([*across, GRAVITY + LIFTED])
        loads = share(force, np.cross(lever, force), holds[0])
        worst = max(worst, *(max(hold.use(load).values()) for hold, load in zip(holds[0], loads, strict=True)))
    return worst


def _laid(point: Array, normal: Array) -> Array:
    """T_part_tool (4, 4) with the TCP on a surface point and tool z against its normal."""
    axis = np.eye(3)[int(np.argmin(np.abs(normal)))]
    x = np.cross(axis, normal)
    x /= np.linalg.norm(x)
    return make_transform(np.stack([x, np.cross(-normal, x), -normal], axis=1), point)


def _level(workpiece: Workpiece, gripper: OneSidedGripper, T_part_tool: Array) -> Array:
    """The pose turned so that its faces lie in the plane that their rims meet, and moved until they touch."""
    xy = np.concatenate([ring(gripper.radius, 12) + centre for centre in gripper.centres])
    for _ in range(LEVELLED):
        gap = probe_part(workpiece, T_part_tool, xy).gap
        if not np.isfinite(gap).all():
            return T_part_tool
        a, b, c = np.linalg.lstsq(np.column_stack([xy, np.ones(len(xy))]), gap, rcond=None)[0]
        z = np.array([-a, -b, 1.0]) / np.sqrt(a * a + b * b + 1.0)
        x = np.array([1.0, 0.0, a]) / np.sqrt(1.0 + a * a)
        T_part_tool = T_part_tool @ make_transform(np.stack([x, np.cross(z, x), z], axis=1), (0.0, 0.0, float(c)))
    gap = probe_part(workpiece, T_part_tool, np.concatenate([xy, gripper.centres])).gap
    return T_part_tool @ make_transform(t=(0.0, 0.0, float(gap.min()) if np.isfinite(gap.min()) else 0.0))


def pressed_by(gripper: OneSidedGripper) -> tuple[float, ...]:
    """How far past the surface the faces go [m], most wanted first; there is not always room beneath the surface."""
    alone = isinstance(gripper, VacuumGripper) and gripper.sprung_alone
    return (PRESS_ALONE * gripper.stroke, PRESS) if alone else (PRESS,)


def _point(T_part_tool: Array, gripper: OneSidedGripper) -> GraspPoint:
    plain = [[round(float(x), 6) + 0.0 for x in v] for v in T_part_tool[:3, [3, 2, 0]].T]
    single = len(gripper.centres) == 1
    return GraspPoint.model_validate(
        {
            "name": "proposed",
            "centre": plain[0],
            "approach": plain[1],
            "closing": plain[2],
            "width": gripper.diameter,
            "depths": pressed_by(gripper),
            "approach_rotation": Turn(to_deg=135.0, step_deg=45.0) if single else Turn(),
        }
    )
