"""The bracket, its gripper, and a bin."""

from __future__ import annotations

import pytest

from cell.bin import Bin
from cell.gripper import load_gripper
from cell.tool import Gripper
from cell.workpiece import Workpiece, load_workpiece
from grasping.grasp_points import GraspPoses, load_grasps


@pytest.fixture(scope="session")
def bracket() -> Workpiece:
    return load_workpiece("bracket")


@pytest.fixture(scope="session")
def gripper() -> Gripper:
    return load_gripper("jaw_v1")


@pytest.fixture(scope="session")
def poses(bracket: Workpiece, gripper: Gripper) -> GraspPoses:
    return load_grasps(bracket, gripper)


@pytest.fixture(scope="session")
def source() -> Bin:
    return Bin("source", (0.26, 0.20, 0.06), 0.006, (0.45, 0.0, 0.01), 0.3)
