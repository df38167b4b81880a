"""Shared by the tests of the cell: the shipped part and gripper, and worlds that are closed after use."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from cell.gripper import load_gripper
from cell.tool import Gripper
from cell.workpiece import Workpiece, load_workpiece
from cell.world import World


@pytest.fixture(scope="session")
def bracket() -> Workpiece:
    return load_workpiece("bracket")


@pytest.fixture(scope="session")
def gripper() -> Gripper:
    return load_gripper("jaw_v1")


@pytest.fixture
def new_world() -> Iterator[Callable[..., World]]:
    worlds: list[World] = []

    def make(**options: object) -> World:
        worlds.append(World(**options))
        return worlds[-1]

    yield make
    for world in worlds:
        world.close()
