"""Do the planner's collision check and the physics see the same? Random configurations, by Coal and by PyBullet.

    python -m tests.benchmarks.collision_agreement --configurations 100000

Arm, jaw, held part, table, both bins and a pile of tall boxes, built twice from the same numbers. Where the two
disagree, Coal's security margin and PyBullet's distance tell how far from contact the configuration is.
PyBullet measures distances here (`getClosestPoints`, less its collision margins), it does not step.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from pickproof.cell.frames import Array, to_quat_xyzw
from pickproof.cell.geometry.bin import Box
from pickproof.cell.physics._pybullet import connect, pybullet
from pickproof.cell.workpiece.collision_pieces import CollisionBox
from pickproof.robots.collision.scene import CollisionScene
from pickproof.robots.kinematics.model import RobotModel, load_robot
from tests.robots.arm_cell import CELL, PART, T_FLANGE_TOOL, TOOL

NEAR = 0.001  # [m] from contact within which the two may disagree
HELD = PART.seen_from(T_FLANGE_TOOL)
HELD_BOXES = tuple(Box("held", p.size, HELD.T @ p.T_part_box) for p in PART.pieces if isinstance(p, CollisionBox))
PILE = tuple(
    Box(f"pile_{i}_{j}", (0.04, 0.04, 0.02 + 0.012 * ((3 * i + 5 * j) % 7)), T)
    for i in range(5)
    for j in range(3)
    for T in [np.array([[1, 0, 0, 0.37 + 0.04 * i], [0, 1, 0, -0.04 + 0.04 * j], [0, 0, 1, 0.04], [0, 0, 0, 1.0]])]
)


class Physics:
    """The same bodies in PyBullet: the arm's own URDF, and the boxes of tool, part and cell as one body each."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot, self.client = robot, connect()
        flags = pybullet.URDF_USE_IMPLICIT_CYLINDER
        self.arm = self.client.loadURDF(str(robot.urdf), useFixedBase=True, flags=flags)
        infos = [self.client.getJointInfo(self.arm, j) for j in range(self.client.getNumJoints(self.arm))]
        self.joints = [{i[1].decode(): i[0] for i in infos}[name] for name in robot.joints]
        self.flange = {i[12].decode(): i[0] for i in infos}["tool0"]
        self.tool, self.held, self.fixed = (self._body(boxes) for boxes in (TOOL, HELD_BOXES, (*CELL, *PILE)))
        self.each_carried, self.each_fixed = (
            [self._body([box]) for box in boxes] for boxes in ((*TOOL, *HELD_BOXES), (*CELL, *PILE))
        )

    def every_distance(self, q: Array) -> float:
        """As `distance`, every box for itself: between two bodies of several boxes the engine misses some pairs."""
        best, carried = self.distance(q), [self.arm, *self.each_carried]
        state = self.client.getLinkState(self.arm, self.flange)
        for body in self.each_carried:
            self.client.resetBasePositionAndOrientation(body, *state[4:6])
        for a in carried:
            for b in self.each_fixed:
                points = self.client.getClosestPoints(a, b, best)
                best = min([best, *(p[8] for p in points if a != self.arm or p[3] in self.joints)])
        return best

    def distance(self, q: Array) -> float:
        """Least distance in [m] of any pair that the planner checks at q (6,), at most 2 NEAR; below 0 they overlap."""
        for joint, angle in zip(self.joints, q, strict=True):
            self.client.resetJointState(self.arm, joint, float(angle))
        state = self.client.getLinkState(self.arm, self.flange, computeForwardKinematics=True)
        for body in (self.tool, self.held):
            self.client.resetBasePositionAndOrientation(body, *state[4:6])
        best = 2 * NEAR

        def near(a: int, b: int, **which: int) -> None:
            nonlocal best
            for point in self.client.getClosestPoints(a, b, best, **which):
                best = min(best, point[8])

        chain = [-1, *self.joints]  # a joint's index is that of the link that it moves
        for i, link in enumerate(chain):
            if i:
                near(self.arm, self.fixed, linkIndexA=link)
            for other in chain[i + 2 :]:
                near(self.arm, self.arm, linkIndexA=link, linkIndexB=other)
            for body, last in ((self.tool, 4), (self.held, 5)):
                if i <= last:
                    near(self.arm, body, linkIndexA=link)
        near(self.tool, self.fixed)
        near(self.held, self.fixed)
        return best

    def _body(self, boxes: Sequence[Box]) -> int:
        """One body of several boxes, their common frame at the origin."""
        shape = self.client.createCollisionShapeArray(
            shapeTypes=[pybullet.GEOM_BOX] * len(boxes),
            halfExtents=[[s / 2 for s in b.size] for b in boxes],
            collisionFramePositions=[b.T_world_box[:3, 3].tolist() for b in boxes],
            collisionFrameOrientations=[to_quat_xyzw(b.T_world_box).tolist() for b in boxes],
        )
        return int(self.client.createMultiBody(baseCollisionShapeIndex=shape))


def compare(configurations: int, seed: int = 0) -> dict[str, Any]:
    """Counts of free and touching configurations, and of disagreements near to and far from contact.

    Half of the configurations are anywhere within the joint limits, half with the hand about the bins, where most of
    the touching is.
    """
    robot = load_robot("lrmate200id")
    scene = CollisionScene(robot, TOOL, (*CELL, *PILE))
    scene.hold(HELD)
    checker, physics = scene._checker("transit"), Physics(robot)
    rng, counts = np.random.default_rng(seed), Counter[str]()
    far: list[list[float]] = []
    low, high = np.deg2rad([-80, 0, -75, -60, -120, -180]), np.deg2rad([20, 75, 10, 60, -20, 180])
    for k in range(configurations):
        q = rng.uniform(robot.lower, robot.upper) if k % 2 else rng.uniform(low, high)
        free, distance = checker.free(q), physics.distance(q)
        counts["free" if free else "touching"] += 1
        if free == (distance > 0):
            continue
        distance = physics.every_distance(q)
        if free == (distance > 0):
            continue
        # free by Coal: is it within NEAR of contact? touching by Coal: is PyBullet's gap no more than NEAR?
        near = not checker.free(q, NEAR) if free else distance < NEAR
        counts["near" if near else "far"] += 1
        if not near:
            far.append(q.tolist())
    physics.client.disconnect()
    return {**{key: counts[key] for key in ("free", "touching", "near", "far")}, "far_at": far}


def main() -> int:
    """Print the counts; 1 where the two disagree beyond NEAR."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--configurations", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    found = compare(args.configurations, args.seed)
    print(
        f"{args.configurations} configurations: {found['free']} free, {found['touching']} touching; "
        f"{found['near']} disagreements within {1000 * NEAR:.0f} mm of contact, {found['far']} beyond"
    )
    for q in found["far_at"][:20]:
        print("  ", np.round(q, 4).tolist())
    return int(found["far"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
