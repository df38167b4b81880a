"""A cup or a magnet on the arm over a workpiece, to be pulled off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickproof.cell.frames import Array, apply, invert, make_transform
from pickproof.cell.geometry.bin import Box
from pickproof.cell.grippers.one_sided import OneSidedGripper
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.grip import Grip, grip, held
from pickproof.cell.physics.world import GRAVITY, World
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.robots.kinematics.inverse import inverse
from pickproof.robots.kinematics.model import load_robot

FACE = np.array([0.42, 0.0, 0.25])
"""Where the middle of the faces stands, in the world."""
DOWN = np.diag([1.0, -1.0, -1.0])


@dataclass
class OneSidedCell:
    """The arm stands still with a workpiece under it; `gap` [m] was between the faces and its top when it was taken."""

    world: World
    arm: Arm
    workpiece: Workpiece
    grip: Grip
    gap: float

    @staticmethod
    def build(
        gripper: OneSidedGripper,
        workpiece: Workpiece,
        offset: tuple[float, float] = (0.0, 0.0),
        gap: float = 0.0002,
        tilt: float = 0.0,
    ) -> OneSidedCell:
        """Take a workpiece whose top lies `gap` [m] under the faces, its centre `offset` from theirs; drop the stand.

        `tilt` [rad] of the workpiece about world y; the lip's lower side is then `gap` over it.
        """
        robot, world = load_robot("lrmate200id"), World()
        arm = Arm(world, robot.urdf, robot.joints, gripper)
        flange = make_transform(DOWN, FACE) @ invert(gripper.T_flange_tool)
        arm.reset(inverse(robot, flange[None]).q[0, 0])
        T = make_transform(t=(0, 0, 0))
        T[:3, :3] = [[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]]
        low, high = (f(apply(T, workpiece.vertices)[:, 2]) for f in (np.min, np.max))
        T[:3, 3] = FACE[0] + offset[0], FACE[1] + offset[1], FACE[2] - gap - high
        if tilt:
            edge = workpiece.extents[2] / 2 / np.cos(tilt) + gripper.radius * np.tan(abs(tilt))
            T[2, 3] = FACE[2] - gap - edge
        if tilt == 0:
            world.add_box(Box("stand", (0.05, 0.05, 0.1), make_transform(t=T[:3, 3] + (0, 0, low - 0.05))))
        world.add_part(workpiece, T)
        if tilt:  # no stand: gravity waits
            world.client.setGravity(0, 0, 0)
        taken = grip(world, arm)
        gap = float(arm.face_pose()[2, 3] - world.part_pose(0)[2, 3] - workpiece.extents[2] / 2)
        if tilt == 0:
            world.remove_box("stand")
        world.client.setGravity(0, 0, -GRAVITY)
        world.run(0.05)
        return OneSidedCell(world, arm, workpiece, taken, gap)

    @property
    def held(self) -> bool:
        return held(self.world, self.arm) == (0,)

    def pull(self, force: Array, moment: Array, rate: float, limit: float) -> float:
        """Raise s in a load s * (force [N], moment [N m]) about the middle of the faces until the workpiece comes off.

        Returns s at that moment, or `limit` when it held. The moment is applied as a pair of forces.
        """
        s = 0.0
        while self.held and s < limit:
            s += rate * self.world.dt
            self._push(s * np.asarray(force), s * np.asarray(moment))
            self.world.step()
        return s

    def carry(self, s: float, force: Array, moment: Array, seconds: float = 0.3) -> bool:
        """Whether it still hangs after a constant load."""
        for k in range(round(seconds / self.world.dt)):
            ramp = min(1.0, k / 48)  # over 0.1 s
            self._push(ramp * s * np.asarray(force), ramp * s * np.asarray(moment))
            self.world.step()
        return self.held

    def _push(self, force: Array, moment: Array) -> None:
        client, body = self.world.client, self.world.parts[0]
        face = self.arm.face_pose()[:3, 3]

        def apply_at(f: Array, at: Array) -> None:
            client.applyExternalForce(body, -1, f.tolist(), at.tolist(), client.WORLD_FRAME)

        apply_at(force, face)
        size = float(np.linalg.norm(moment))
        if size > 0:
            axis = moment / size
            across = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
            across /= np.linalg.norm(across)
            arm = 0.05
            push = size / (2 * arm) * np.cross(axis, across)
            apply_at(push, face + arm * across)
            apply_at(-push, face - arm * across)
