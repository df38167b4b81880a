"""Filling a bin: workpieces fall in seeded order through a chute and settle; then the chute is removed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickproof.cell.errors import SimulationError
from pickproof.cell.frames import Array, make_transform
from pickproof.cell.geometry.bin import Bin, Box
from pickproof.cell.physics.world import GRAVITY, World, random_pose
from pickproof.cell.workpiece.workpiece import Workpiece

CHUTE_HEIGHT = 0.25  # [m] over the rim
LAYERS = 3


@dataclass(frozen=True)
class Heap:
    """A settled bin: `Ts_world_part` (n, 4, 4) and whether each workpiece lies inside the bin (n,)."""

    Ts_world_part: Array
    inside: np.ndarray


def fill_bin(world: World, workpiece: Workpiece, bin: Bin, count: int, rng: np.random.Generator) -> Heap:
    """Drop `count` workpieces into `bin` and wait until they rest.

    Three workpieces fall at a time, each from its own layer and with uniform random rotation, after the three before
        have left the layers: bodies that start interpenetrating stay jammed. The chute keeps bouncing workpieces from
            leaving the bin, as the funnel of a real filling station does. A workpiece longer than the bin's width falls
            in aligned with the bin.

    Raises:
        SimulationError: the heap does not come to rest within 8 s of simulated time.
    """
    chute = _chute(bin)
    for box in chute:
        world.add_box(box, friction=0.0)
    reach = float(np.linalg.norm(workpiece.extents)) / 2
    lx, ly, lz = bin.inner
    long = 2 * reach > min(lx, ly)
    layer = min(reach, CHUTE_HEIGHT / 2) if long else reach  # half its height
    half = (max(lx / 2 - reach, 0.0), max(ly / 2 - reach, 0.0))
    first = len(world.parts)
    # [s] in which the highest layer falls below the lowest
    fall = float(np.sqrt(2 * (2 * LAYERS + 1) * layer / GRAVITY))
    for i in range(count):
        if i % LAYERS == 0:
            lowest = max(lz + 0.02, _top(world, bin, first, workpiece.extents if long else np.zeros(3)) + layer)
        centre = (0.0, 0.0, lowest + layer * (1 + 2 * (i % LAYERS)))
        pose = _lying_pose(centre, workpiece.extents, bin, rng) if long else random_pose(centre, half, rng)
        world.add_part(workpiece, bin.T_world_bin @ pose)
        if i % LAYERS == LAYERS - 1:
            world.run(fall)
    # no sleep: workpieces that lean on the chute must fall when it is removed
    rested = world.run_until_rest(8.0, sleep=False)
    for box in chute:
        world.remove_box(box.name)
    world.run(0.05)
    if not (rested and world.run_until_rest(4.0)):
        raise SimulationError(f"{count} x {workpiece.name} do not come to rest in the bin; use fewer or a larger bin")
    Ts = world.part_poses()[first:]
    return Heap(Ts, bin.contains(Ts[:, :3, 3], above=reach))


def _top(world: World, bin: Bin, first: int, extents: Array) -> float:
    """Height [m] over the bin's floor of the highest workpiece from index `first` on, each a box of `extents`."""
    Ts = world.part_poses()[first:]
    heights = Ts[:, 2, 3] - bin.position[2] + np.abs(Ts[:, 2, :3]) @ extents / 2
    return float(heights.max(initial=0.0))


def _lying_pose(centre: tuple[float, float, float], extents: Array, bin: Bin, rng: np.random.Generator) -> Array:
    """A random pose in the bin's frame in which a box of `extents` lies flat and fits between the walls."""
    room = np.array([bin.inner[0], bin.inner[1], CHUTE_HEIGHT / 2]) - 0.01
    for _ in range(20_000):
        pose = random_pose(centre, (0.0, 0.0), rng)
        spare = (room - np.abs(pose[:3, :3]) @ extents) / 2
        if (spare >= 0).all():
            pose[:2, 3] += rng.uniform(-1.0, 1.0, 2) * spare[:2]
            return pose
    size = np.round(extents, 3).tolist()
    raise SimulationError(f"a workpiece of {size} m does not fit in {bin.name} of {bin.inner} m")


def _chute(bin: Bin) -> list[Box]:
    """Four frictionless walls over the rim."""
    walls = []
    for box in bin.boxes()[1:]:
        lift = make_transform(t=(0.0, 0.0, bin.inner[2] / 2 + CHUTE_HEIGHT / 2))
        size = (box.size[0], box.size[1], CHUTE_HEIGHT)
        walls.append(Box(f"chute_{box.name}", size, box.T_world_box @ lift))
    return walls
