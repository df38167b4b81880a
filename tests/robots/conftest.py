"""The arm, and a scene of its cell over a flat pile."""

from __future__ import annotations

import numpy as np
import pytest

from robots.collision import CollisionScene, HeightField
from robots.model import RobotModel, load_robot
from tests.robots.arm_cell import CELL, TOOL


@pytest.fixture(scope="session")
def robot() -> RobotModel:
    return load_robot("lrmate200id")


@pytest.fixture
def scene(robot: RobotModel) -> CollisionScene:
    pile = HeightField(np.full((100, 130), 0.03), 0.32, -0.1, 0.002)
    return CollisionScene(robot, TOOL, CELL, pile)
