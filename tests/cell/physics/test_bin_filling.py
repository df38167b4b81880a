"""The settled heap: lies in the bin, nothing in anything else, asleep until touched, the same everywhere."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from pickproof.cell.frames import apply, invert, make_transform
from pickproof.cell.geometry.bin import Bin, table
from pickproof.cell.physics.bin_filling import Heap, fill_bin
from pickproof.cell.physics.world import World
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece

pytestmark = pytest.mark.slow

BIN = Bin("source", (0.30, 0.22, 0.12), 0.006, (0.45, 0.0, 0.006))
COUNT = 30


def filled(seed: int) -> tuple[World, Heap]:
    world = World()
    world.add_box(table((1.6, 1.6, 0.04), (0.3, 0.0, 0.0)))
    world.add_bin(BIN)
    return world, fill_bin(world, load_workpiece("bracket"), BIN, COUNT, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def heap() -> Iterator[tuple[World, Heap]]:
    world, settled = filled(2)
    yield world, settled
    world.close()


def test_everything_lies_in_the_bin(heap: tuple[World, Heap], bracket: Workpiece) -> None:
    world, settled = heap
    assert settled.inside.all() and len(settled.Ts_world_part) == COUNT
    vertices = apply(invert(BIN.T_world_bin) @ settled.Ts_world_part, bracket.vertices)
    assert vertices[..., 2].min() > -1e-4  # nothing sinks into the floor
    for axis in (0, 1):
        assert np.abs(vertices[..., axis]).max() < BIN.inner[axis] / 2 + 1e-4
    assert not any(name.startswith("chute") for name in world.boxes)


@pytest.mark.parametrize("seed", [2, 3])  # both once left a pair of workpieces jammed in one another
def test_nothing_lies_in_anything_else(seed: int) -> None:
    world, _ = filled(seed)
    contacts = world.client.getContactPoints()
    assert len(contacts) > COUNT
    assert min(c[8] for c in contacts) > -2e-4
    world.close()


def test_a_settled_heap_sleeps(heap: tuple[World, Heap]) -> None:
    world, settled = heap
    world.run(0.2)
    np.testing.assert_array_equal(world.part_poses(), settled.Ts_world_part)
    assert world.at_rest().all()


def test_awake_it_stays_where_it_is() -> None:
    world, settled = filled(4)
    for body in world.parts:
        world.client.changeDynamics(body, -1, activationState=world.client.ACTIVATION_STATE_WAKE_UP)
    world.run(0.25)
    assert np.abs(world.part_poses() - settled.Ts_world_part)[:, :3, 3].max() < 2e-4
    world.close()


def test_a_touch_wakes_the_pile(heap: tuple[World, Heap], bracket: Workpiece) -> None:
    """Another one thrown at the topmost at 3 m/s; one that falls on it may come to lie there and shift nothing."""
    world, settled = heap
    top = settled.Ts_world_part[int(np.argmax(settled.Ts_world_part[:, 2, 3]))]
    inwards = np.array([BIN.position[0] - top[0, 3], BIN.position[1] - top[1, 3], 0.0])
    inwards /= np.linalg.norm(inwards)
    world.add_part(bracket, make_transform(t=0.07 * inwards) @ top)
    world.client.resetBaseVelocity(world.parts[-1], (-3.0 * inwards).tolist())
    world.run(0.4)
    moved = np.linalg.norm((world.part_poses()[:COUNT] - settled.Ts_world_part)[:, :3, 3], axis=1)
    assert moved.max() > 5e-3
