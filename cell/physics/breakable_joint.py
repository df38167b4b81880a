"""A breakable connection of a workpiece to cups or magnets; its load is read after every step.

A fixed constraint carries the workpiece; PyBullet's own `maxForce` saturates instead of breaking. The reaction is
shared among the cups (`cell.grippers.one_sided_hold`). A cup releases as soon as its share exceeds one of its limits;
the constraint is removed with the last one. Collisions between faces and workpiece are off meanwhile, since contact and
constraint would act against each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pickproof.cell.frames import Array, from_quat_xyzw, invert, make_transform, to_quat_xyzw
from pickproof.cell.grippers.one_sided_hold import Hold, Limit, share
from pickproof.cell.physics._pybullet import pybullet
from pickproof.cell.physics.world import World

STIFF = 1e5  # [N] largest force of the constraint: more than any hold carries


class Connection:
    """Holds one workpiece on a link of a gripper.

    Attributes:
        part: index of the workpiece.
        holds: cups or magnets that still hold; none when the workpiece is lost.
        lost: limits that were exceeded, in order.
        use: largest share of each limit so far of any hold while it held.
        load: (6,) force [N] and moment [N m] of the workpiece on the gripper after the last step, in the tool frame at
            the TCP.
    """

    def __init__(
        self, world: World, body: int, link: int, part: int, holds: Sequence[Hold], T_world_tool: Array
    ) -> None:
        self.part, self.holds, self.lost = part, list(holds), list[Limit]()
        self.use: dict[Limit, float] = {"normal": 0.0, "shear": 0.0, "moment": 0.0}
        self.load = np.zeros(6)
        self._world, self._body, self._link = world, body, link
        client, self._child = world.client, world.parts[part]
        T_world_link = self._link_pose()
        T_world_child = from_quat_xyzw(*client.getBasePositionAndOrientation(self._child))
        self._T_link_tool = invert(T_world_link) @ T_world_tool
        # Bullet inverts the child's frame when the child is a plain rigid body: only the identity is safe, so both
        # frames take the workpiece's orientation, and its moments come in the workpiece's axes
        self._R_link_child = T_world_link[:3, :3].T @ T_world_child[:3, :3]
        pivot = (invert(T_world_child) @ T_world_tool)[:3, 3]
        self._id = client.createConstraint(
            body,
            link,
            self._child,
            -1,
            pybullet.JOINT_FIXED,
            [0, 0, 0],
            self._T_link_tool[:3, 3].tolist(),
            pivot.tolist(),
            to_quat_xyzw(make_transform(self._R_link_child)).tolist(),
            [0, 0, 0, 1],
        )
        client.changeConstraint(self._id, maxForce=STIFF)
        client.setCollisionFilterPair(body, self._child, link, -1, 0)
        world.held.add(part)
        world.wake(part)

    @property
    def alive(self) -> bool:
        """Whether at least one cup or magnet holds."""
        return bool(self.holds)

    def check(self) -> None:
        """Read the reaction of the last step and release every hold above its limit; call it after every step."""
        if not self.holds:
            return
        reaction = np.array(self._world.client.getConstraintState(self._id))  # force in world axes
        R_world_link = self._link_pose()[:3, :3]
        R_tool_world = (R_world_link @ self._T_link_tool[:3, :3]).T
        force = R_tool_world @ reaction[:3]
        moment = R_tool_world @ R_world_link @ self._R_link_child @ reaction[3:]
        self.load = np.concatenate([force, moment])
        kept = []
        for hold, load in zip(self.holds, share(force, moment, self.holds), strict=True):
            limit = hold.lost_by(load)
            if limit is not None:
                self.lost.append(limit)
            else:
                kept.append(hold)
                use = hold.use(load)
                self.use = {limit: max(value, use[limit]) for limit, value in self.use.items()}
        self.holds = kept
        if not kept:
            self._cut()

    def release(self) -> None:
        """Release the workpiece on command."""
        if self.holds:
            self.holds = []
            self._cut()

    def _cut(self) -> None:
        client = self._world.client
        client.removeConstraint(self._id)
        client.setCollisionFilterPair(self._body, self._child, self._link, -1, 1)
        self._world.held.discard(self.part)
        self._world.wake(self.part)

    def _link_pose(self) -> Array:
        """T_world_link (4, 4) of the link's centre of mass; PyBullet defines constraints in that frame."""
        state = self._world.client.getLinkState(self._body, self._link, computeForwardKinematics=True)
        return from_quat_xyzw(state[0], state[1])
