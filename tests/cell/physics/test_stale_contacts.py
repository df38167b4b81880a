"""Contact points are found anew where the fingers let go: old ones can glue a workpiece to one finger."""

from __future__ import annotations

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.physics.trajectory_execution import close_jaws, execute, forget_contacts
from tests.cell.physics.grasp_cell import GraspCell


def closing_components(cell: GraspCell) -> tuple[Array, Array]:
    """Of the contact normals of each finger, along the closing direction of the jaws."""
    x = cell.arm.tool_pose()[:3, 0]
    left, right = (
        np.array([x @ point[7] for point in cell.world.client.getContactPoints(bodyA=cell.arm.body, linkIndexA=link)])
        for link in cell.arm.finger_links
    )
    return left, right


def test_contacts_that_turned_with_the_hand_are_forgotten() -> None:
    """PyBullet keeps a point with the world normal it had when it was found; here the hand turns by 160 degrees."""
    cell = GraspCell.build()
    above = cell.above()
    cell.line(cell.grasp(), 8.0)
    close_jaws(cell.world, cell.arm)
    cell.line(above, 8.0)
    start, turned = cell.arm.q.copy(), cell.arm.q + np.array([0, 0, 0, 0, 0.5, 0.9 * np.pi])
    s = np.linspace(0, 1, 1500)[:, None]
    execute(cell.world, cell.arm, start + s**3 * (10 - 15 * s + 6 * s * s) * (turned - start))
    stale = np.concatenate(closing_components(cell))
    assert np.abs(stale).min() < 0.9  # else this test shows nothing

    forget_contacts(cell.world, cell.arm)
    assert not np.concatenate(closing_components(cell)).size
    cell.world.step()
    left, right = closing_components(cell)
    cell.world.close()
    assert len(left) and len(right)
    assert np.abs(np.concatenate([left, right])).min() > 0.99
    assert (np.sign(left) == -np.sign(right[0])).all()
