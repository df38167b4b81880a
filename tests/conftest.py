"""Shared by all tests: the shipped part and gripper, the arm with its cell, and worlds that are closed after use."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from pickproof.cell.geometry.bin import Bin
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.physics.world import World
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.grasping.grasp_points import GraspPoses, load_grasps
from pickproof.robots.collision.scene import CollisionScene, HeightField
from pickproof.robots.kinematics.model import RobotModel, load_robot
from tests.robots.arm_cell import CELL, TOOL


@pytest.fixture(scope="session")
def bracket() -> Workpiece:
    return load_workpiece("bracket")


@pytest.fixture(scope="session")
def gripper() -> Gripper:
    """The parallel jaw of the bracket's cell."""
    return load_gripper("jaw_v1")


@pytest.fixture(scope="session")
def poses(bracket: Workpiece, gripper: Gripper) -> GraspPoses:
    """All grasp poses of the bracket."""
    return load_grasps(bracket, gripper)


@pytest.fixture(scope="session")
def source() -> Bin:
    """The source bin of the small cell."""
    return Bin("source", (0.26, 0.20, 0.06), 0.006, (0.45, 0.0, 0.01), 0.3)


@pytest.fixture(scope="session")
def robot() -> RobotModel:
    return load_robot("lrmate200id")


@pytest.fixture
def scene(robot: RobotModel) -> CollisionScene:
    """The small cell around the arm, over a flat pile."""
    pile = HeightField(np.full((100, 130), 0.03), 0.32, -0.1, 0.002)
    return CollisionScene(robot, TOOL, CELL, pile)


@pytest.fixture
def new_world() -> Iterator[Callable[..., World]]:
    """Makes worlds that are closed at the end of the test."""
    worlds: list[World] = []

    def make(**options: object) -> World:
        worlds.append(World(**options))
        return worlds[-1]

    yield make
    for world in worlds:
        world.close()
