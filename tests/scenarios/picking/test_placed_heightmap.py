from __future__ import annotations

import numpy as np

from pickproof.cell.frames import about_axis, apply, make_transform
from pickproof.cell.geometry.bin import Bin, table
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.robots.collision.scene import CollisionScene
from pickproof.robots.kinematics.inverse import inverse
from pickproof.robots.kinematics.model import load_robot
from pickproof.scenarios.picking.placed_heightmap import Placed
from tests.robots.arm_cell import DOWN

BRACKET, BIN = load_workpiece("bracket"), Bin("place", (0.30, 0.20, 0.06), 0.006, (0.40, 0.0, 0.01), 0.3)


def test_heights_are_those_of_what_was_placed() -> None:
    placed = Placed(BIN, BRACKET)
    assert placed.heights() is None
    Ts = [BIN.T_world_bin @ make_transform(t=(x, 0.02, 0.03)) @ about_axis((0, 0, 1), x) for x in (-0.08, 0.06)]
    for T in Ts:
        placed.add(T, 0.01)
    assert placed.heights(last=False) is not None
    for k, field in ((2, placed.heights()), (1, placed.heights(last=False))):
        assert field is not None
        for i, T in enumerate(Ts):
            surface = apply(make_transform(t=(0, 0, -0.01)) @ T, BRACKET.sample_surface(5000, seed=1)[0])
            column, row = np.rint((surface[:, :2] - (field.x0, field.y0)) / field.step).astype(int).T
            over = field.heights[row, column] - surface[:, 2]
            assert (over.min() > -2e-3) == (i < k)
        assert (field.heights.max(axis=None) < 0.06) and np.median(field.heights) < BIN.position[2]


def test_the_hand_keeps_off_what_was_placed_but_not_off_what_it_just_let_go() -> None:
    robot, gripper, placed = load_robot("lrmate200id"), load_gripper("jaw_v1"), Placed(BIN, BRACKET)
    spots = [BIN.T_world_bin @ make_transform(t=(x, 0.0, 0.02)) for x in (-0.08, 0.08)]
    for T in spots:
        placed.add(T, 0.01)
    scene = CollisionScene(
        robot, gripper.flange_boxes(0.02), [table((2.0, 2.0, 0.05), (0.2, 0, 0))], None, None,
        placed.heights(), placed.heights(last=False),
    )  # fmt: skip
    over = [make_transform(DOWN, (*T[:2, 3], 0.012)) @ np.linalg.inv(gripper.T_flange_tool) for T in spots]
    first, last = (inverse(robot, T[None], robot.home).q[0, 0] for T in over)
    for q in (first, last):
        for mode in ("transit", "leave", "depart"):
            contact = scene.first_contact(q, mode)
            assert (contact is None) == (q is last and mode == "depart")
            assert contact is None or contact[1] == "placed"
