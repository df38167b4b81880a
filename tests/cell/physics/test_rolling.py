"""A shaft that lies on a level floor stays there, and one that rolls comes to rest: no energy out of nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pickproof.cell.frames import apply, make_transform
from pickproof.cell.geometry.bin import table
from pickproof.cell.physics.world import GRAVITY, World
from pickproof.cell.workpiece.workpiece import load_workpiece

LYING = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@pytest.fixture
def world(new_world: Callable[..., World]) -> World:
    """The gear shaft at rest on a table, tilted from gear to thin end."""
    world = new_world()
    world.add_box(table((6.0, 6.0, 0.1), (0.0, 0.0, 0.0)))
    world.add_part(load_workpiece("gear_shaft"), make_transform(LYING, (0.0, 0.0, 0.0505)))
    assert world.run_until_rest(3.0, sleep=False)
    return world


def test_a_shaft_at_rest_stays_at_rest(world: World) -> None:
    before = world.part_pose(0)
    world.run(3.0)
    assert np.linalg.norm(world.part_pose(0)[:3, 3] - before[:3, 3]) < 2e-4


def test_teeth_stop_a_rolling_shaft(world: World) -> None:
    """A lever f of the normal force takes f g / (1.5 r) from a rolling body; contact points give some of it back."""
    shaft = load_workpiece("gear_shaft")
    T = world.part_pose(0)
    axis = T[:3, 2] * (1.0, 1.0, 0.0)
    height = float(apply(T, shaft.com[None])[0, 2])
    spin = 0.1 / height * axis / np.linalg.norm(axis)
    velocity = np.cross(spin, (0.0, 0.0, height))
    world.client.resetBaseVelocity(world.parts[0], velocity.tolist(), spin.tolist())
    law = shaft.rolling_friction * np.sqrt(0.5) * GRAVITY / (1.5 * height)  # the floor's share of the lever
    world.run(0.1)
    slower = 0.1 - world.part_speeds()[0, 0]
    assert 0.3 * law * 0.1 < slower < 1.5 * law * 0.1
    world.run(1.0)
    assert world.part_speeds()[0, 0] < 0.005
