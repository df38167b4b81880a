"""Heap placing: slots in layers, so that there is always a free place."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pickproof.cell.frames import Array, about_axis, apply, make_transform
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.symmetry.pose_error import rotation_error
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.clearance import OpenGripper
from pickproof.scenarios.placing.slot_grid import Slots, slots_in
from pickproof.scenarios.placing.slot_usage import SlotUsage

DROP = 0.010  # [m] between the workpiece's lowest point and what is assumed to lie below
MAX_LEAN = np.deg2rad(45.0)  # of the tool from the vertical over a place
MAX_FALL = np.deg2rad(60.0)  # through which a workpiece may fall when it is let go at a slant
SAME_FACE = np.deg2rad(8.0)  # between resting faces that count as one: half a step of an infinite symmetry and a little
UNLIKELY = 0.1  # of the likeliest resting pose's probability: on such a face it stands, and falls at a touch
SLOTS_AT_ONCE = 5
"""Slots to which poses are proposed at a time."""
ABOVE = 0.02  # [m] of the line down to a place over the rim, and over what stands there


@dataclass
class PlacePlan(SlotUsage):
    """Slots in the place bin, filled layer by layer; their use is remembered, not measured.

    Attributes:
        count: workpieces that are to find a place.
        slots: where they may lie.
        rests: (r, 3, 3) rotations of the CAD in which it is likely to lie on a plane, z up.
        leaning: (k,) whether each pose that `tool_poses` returned last releases the workpiece in a tilted pose.
        tight: (k,) whether the jaws, opened all the way, would meet a wall there: for a wider next grasp the arm, which
            waits at the place, could not leave it.
    """

    bin: Bin
    workpiece: Workpiece
    gripper: Gripper
    count: int = 1
    slots: Slots = field(init=False)
    rests: Array = field(init=False)
    leaning: np.ndarray = field(init=False)
    tight: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.slots = slots_in(self.bin, self.workpiece, self.count)
        self._none_yet(len(self.slots.centres))
        self.leaning = self.tight = np.zeros(0, dtype=bool)
        self._widest = OpenGripper.of(self.gripper.boxes(self.gripper.max_opening))
        self.rests = likely_rests(self.workpiece)

    @property
    def line(self) -> float:
        """[m] of straight line down to a pose: over the rim, and over the tallest workpiece that stands there."""
        heights = np.ptp(self.workpiece.vertices @ self.rests[:, 2].T, axis=0)
        return max(self.bin.inner[2], float(heights.max(initial=0.0))) + ABOVE

    @property
    def fall(self) -> float:
        """[m] height of the fall of a released workpiece."""
        return DROP

    @property
    def rounds(self) -> int:
        """Number of calls of `pass_over` until every slot was tried."""
        return -(-len(self.slots.centres) // SLOTS_AT_ONCE)

    def placeable(self, Ts_part_tool: Array) -> np.ndarray:
        """(n,) bool: a workpiece held at (n, 4, 4) can be placed; in a heap always true."""
        return np.ones(len(Ts_part_tool), dtype=bool)

    def tool_poses(self, T_part_tool: Array, opening: float = 0.0) -> Array:
        """TCP poses (k, 4, 4) that release a workpiece held at `T_part_tool`, most wanted first.

        The workpiece is held over the centre of a slot in the resting pose that tilts the tool least; released at a
        slant it could land on an edge and stay upright. After these come the same slots with the tool straight down.
        The least used slots come first, each in several yaws. `opening` [m] of the jaws has no effect here.
        """
        T_tool_part = np.linalg.inv(T_part_tool)
        order = np.argsort(np.add(self.used, self.passed), kind="stable")[:SLOTS_AT_ONCE]
        poses, slots, leaning = [], [], []
        for kind, R in enumerate(self._tool_rotations(T_part_tool)):
            hang = make_transform(R) @ T_tool_part
            hanging = apply(hang, self.workpiece.vertices)
            turns = about_axis((0, 0, 1), self.slots.yaws(hanging[:, :2]))[:, :3, :3]
            centre = hang[:3, 3] * (1.0, 1.0, 0.0)
            heights = np.array(self.used)[order] * self.slots.layer + DROP - hanging[:, 2].min()
            at = np.concatenate([self.slots.centres[order], heights[:, None]], axis=1)
            Ts_bin_tool = make_transform(turns @ R, at[:, None] - turns @ centre)
            poses.append((self.bin.T_world_bin @ Ts_bin_tool).reshape(-1, 4, 4))
            slots.append(np.repeat(order, len(turns)))
            leaning.append(np.full(len(poses[-1]), kind > 0))
        self.slot_of_pose, self.leaning = np.concatenate(slots), np.concatenate(leaning)
        Ts_world_tool = np.concatenate(poses)
        self.tight = self._widest.hits_bin(Ts_world_tool, self.bin)
        return Ts_world_tool

    def _tool_rotations(self, T_part_tool: Array) -> list[Array]:
        """R_bin_tool (3, 3) at yaw 0: the workpiece as flat as the tilt limit of the tool allows, then the tool
        straight down.

        A workpiece that cannot be laid flat is released at a slant, so that it falls to the right side.
        """
        down = about_axis((1, 0, 0), np.array(np.pi))[:3, :3]
        if len(self.rests) == 0:
            return [down]
        flat = self.rests @ T_part_tool[:3, :3]
        best = flat[int(np.argmin(flat[:, 2, 2]))]
        lean = float(np.arccos(np.clip(-best[2, 2], -1.0, 1.0)))
        if lean <= MAX_LEAN:
            return [best, down]
        if lean - MAX_LEAN > MAX_FALL:
            return [down]
        axis = np.cross(best[:, 2], (0.0, 0.0, -1.0))
        upright = about_axis(axis / np.linalg.norm(axis), np.array(lean - MAX_LEAN))[:3, :3]
        return [upright @ best, down]

    def ranks(self) -> tuple[int, ...]:
        """Of each pose in the last `tool_poses`: with room first, then flat ones, then emptier slots."""
        used, more = np.array(self.used)[self.slot_of_pose], max(self.used) + 1
        return tuple(int(r) for r in 2 * more * self.tight + more * self.leaning + used)

    def room(self, T_world_tool: Array, opening: float) -> bool:
        """Whether the gripper, `opening` [m] open, keeps off the bin at a TCP pose."""
        return not OpenGripper.of(self.gripper.boxes(opening)).hits_bin(T_world_tool[None], self.bin)[0]

    def accepts(self, off: float, turned: float) -> bool:
        """A heap has no tolerance."""
        return True


def likely_rests(workpiece: Workpiece) -> Array:
    """Rotations (r, 3, 3) of the CAD in which it is likely to lie on a plane, z up; all symmetric equivalents of each.

    What is equal by symmetry, or to SAME_FACE, counts as one: a round workpiece lies on any of many narrow facets, none
    of which is likely by itself.
    """
    stable, chance = workpiece.mesh.compute_stable_poses(sigma=0.0, n_samples=1, threshold=0.0)
    Rs = np.asarray(stable).reshape(-1, 4, 4)[:, :3, :3]
    turns = workpiece.symmetry.rotations()
    faces: list[tuple[Array, float]] = []
    while len(Rs):  # likeliest first
        same = (Rs[:, 2] @ turns @ Rs[0, 2]).max(axis=0) > np.cos(SAME_FACE)
        faces.append((Rs[0], float(np.sum(chance[same]))))
        Rs, chance = Rs[~same], chance[~same]
    best = max((share for _, share in faces), default=0.0)
    return np.array([R @ S for R, share in faces if share > UNLIKELY * best for S in turns]).reshape(-1, 3, 3)


def place_error(T_world_part: Array, T_world_wanted: Array, workpiece: Workpiece) -> tuple[float, float]:
    """Difference of a resting pose and the release pose: horizontally in [m], and in [rad], symmetry considered.

    The height is left out, because a workpiece is released just above the surface below.
    """
    off = float(np.linalg.norm((T_world_part - T_world_wanted)[:2, 3]))
    return off, float(rotation_error(T_world_wanted[:3, :3], T_world_part[:3, :3], workpiece.symmetry))
