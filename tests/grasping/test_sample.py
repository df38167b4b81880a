"""Proposals from the CAD of the bracket, against a finer sampling of its surface."""

from __future__ import annotations

import numpy as np

from pickproof.cell.frames import apply, invert
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.grasp_points import expand, opening
from pickproof.grasping.sample import propose


def test_proposals_grip_opposed_faces_and_leave_room(bracket: Workpiece, gripper: Gripper) -> None:
    points = propose(bracket, gripper, 3, np.random.default_rng(0))
    assert [p.name for p in points] == ["jaw_1", "jaw_2", "jaw_3"]
    surface, normals = bracket.sample_surface(12_000, seed=9)
    for point in points:
        assert opening(point) <= gripper.max_opening
        middle = np.linalg.norm(np.asarray(point.centre) - bracket.com)
        assert middle < 0.03
        for T in expand((point,), bracket).Ts_part_tool[:: max(len(points), 4)]:
            p, n = apply(invert(T), surface), normals @ T[:3, :3]
            for side in (-1, 1):
                touching = (np.abs(p[:, 0] - side * point.width / 2) < 3e-4) & (n[:, 0] * side > 0.95)
                assert (touching & (np.abs(p[:, 1]) < 0.005) & (p[:, 2] < 0)).sum() > 10
            for box in gripper.boxes(opening(point)):
                inside = (np.asarray(box.size) / 2 - np.abs(p - box.T_world_box[:3, 3])).min(axis=1).max()
                assert inside < 5e-4, (point.name, box.name, inside)


def test_the_same_seed_proposes_the_same(bracket: Workpiece, gripper: Gripper) -> None:
    a, b = (propose(bracket, gripper, 1, np.random.default_rng(3)) for _ in range(2))
    assert a == b and len(a) == 1
