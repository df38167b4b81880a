"""Shared by all tests: the shipped part and gripper, the arm with its cell, worlds that are closed after use, and
campaigns of planted episodes in this process."""

from __future__ import annotations

import sys
import types
from collections.abc import Callable, Iterator
from pathlib import Path

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


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Campaigns run their episodes in this process: starting a worker takes longer than a planted episode."""
    from pickproof.scenarios.campaign import process_pool
    from tests.scenarios.in_process import InProcess

    monkeypatch.setattr(process_pool, "Workers", InProcess)


@pytest.fixture
def planted(in_process: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., int]:
    """The command line with planted episodes, called in an empty folder: words -> exit code."""
    from tests.scenarios import planted_episode

    return _command_line(planted_episode, monkeypatch, tmp_path)


@pytest.fixture
def faked(in_process: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., int]:
    """The same with the episodes of tests/scenarios/fake_episode.py."""
    from tests.scenarios import fake_episode

    return _command_line(fake_episode, monkeypatch, tmp_path)


def _command_line(episode: types.ModuleType, monkeypatch: pytest.MonkeyPatch, folder: Path) -> Callable[..., int]:
    from pickproof.scenarios.commands.cli import main

    no_cell = types.SimpleNamespace(check_inputs=lambda scenario, oracle: None)  # such episodes read no files
    monkeypatch.setitem(sys.modules, "pickproof.scenarios.campaign.episode", episode)
    monkeypatch.setitem(sys.modules, "pickproof.scenarios.picking.workcell", no_cell)
    monkeypatch.chdir(folder)
    return lambda *words: main(words)
