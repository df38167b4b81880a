"""The quick checks of the open gripper against slow ones: dense points of its boxes, one pose at a time."""

from __future__ import annotations

import numpy as np
import pytest

from pickproof.cell.frames import Array, about_axis, apply, invert, make_transform, random_rotations
from pickproof.cell.geometry.bin import Bin, Box
from pickproof.cell.grippers.base import Gripper
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.grasping.clearance import POINT_MARGIN, WALL_MARGIN, OpenGripper, thin, without_workpiece

DOWN = about_axis((1, 0, 0), np.array(np.pi))


def around(bin: Bin, n: int, seed: int) -> Array:
    """Tool poses in and over a bin, tilted up to about 60 degrees."""
    rng = np.random.default_rng(seed)
    lx, ly, lz = bin.inner
    t = rng.uniform([-0.6 * lx, -0.6 * ly, 0.0], [0.6 * lx, 0.6 * ly, 1.5 * lz], (n, 3))
    R = random_rotations(8 * n, rng)
    return bin.T_world_bin @ make_transform(R[R[:, 2, 2] < -0.5][:n], t)


def solid(boxes: list[Box], step: float) -> Array:
    """Points (n, 3) all through some boxes, corners included, at most `step` apart along each edge."""
    out = []
    for box in boxes:
        axes = [np.linspace(-s / 2, s / 2, int(s / step) + 2) for s in box.size]
        out.append(apply(box.T_world_box, np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)))
    return np.concatenate(out)


def penetration(points_world: Array, bin: Bin) -> float:
    """How far in [m] the deepest of the points is in floor, walls or beyond them below the rim; negative: the room."""
    lx, ly, lz = bin.inner
    p = apply(invert(bin.T_world_bin), points_world)
    beyond = np.maximum(np.abs(p[:, 0]) - lx / 2, np.abs(p[:, 1]) - ly / 2)
    return float(np.maximum(-p[:, 2], np.minimum(beyond, lz - p[:, 2])).max())


@pytest.mark.slow
def test_hits_bin_is_what_dense_points_of_the_gripper_say(gripper: Gripper, source: Bin) -> None:
    boxes = gripper.boxes(0.03)
    points = solid(boxes, 0.0015)
    Ts = around(source, 400, seed=1)
    quick = OpenGripper.of(boxes).hits_bin(Ts, source)
    deepest = np.array([penetration(apply(T, points), source) for T in Ts])
    assert quick[deepest > -WALL_MARGIN].all()  # never in a wall unseen
    assert not quick[deepest < -WALL_MARGIN - 0.001].any()  # and never a false alarm, but for the points' spacing
    assert 0.1 < quick.mean() < 0.9


def test_a_finger_across_the_rim_is_seen_though_both_its_ends_are_free(source: Bin) -> None:
    """The tip is inside, below the rim; the other end is over the rim, outside; the wall is in between."""
    finger = Box("finger", (0.004, 0.004, 0.080), make_transform())
    lx, _, lz = source.inner
    over_wall = source.T_world_bin @ make_transform(t=(lx / 2, 0.0, lz)) @ about_axis((0, 1, 0), np.array(np.pi / 4))
    lifted = make_transform(t=(0, 0, 0.012)) @ over_wall
    shape = OpenGripper.of([finger])
    assert shape.hits_bin(np.stack([over_wall, lifted]), source).tolist() == [True, False]


@pytest.mark.parametrize(
    ("where", "hit"),
    [
        ((0.0, 0.0, WALL_MARGIN + 1e-5), False),
        ((0.0, 0.0, WALL_MARGIN - 1e-5), True),
        ((0.130 - 0.025 - 0.0009, 0.0, 0.03), False),
        ((0.130 - 0.025 - 0.0007, 0.0, 0.03), True),
        ((-0.130 + 0.025 + 0.0007, 0.0, 0.03), True),
        ((0.0, 0.100 - 0.015 - 0.0009, 0.03), False),  # the finger's width, not the opening
        ((0.0, 0.100 - 0.015 - 0.0007, 0.03), True),
        ((0.0, -0.100 + 0.015 + 0.0007, 0.03), True),
        ((0.130, 0.0, 0.0609), False),  # over the rim
        ((0.130, 0.0, 0.0607), True),
    ],
)
def test_floor_walls_and_rim_by_hand(source: Bin, where: tuple[float, float, float], hit: bool) -> None:
    """A gripper 50 mm along x and 30 mm along y whose lowest point is the TCP, pointing straight down."""
    shape = OpenGripper.of([Box("body", (0.050, 0.030, 0.070), make_transform(t=(0, 0, -0.035)))])
    T = source.T_world_bin @ make_transform(t=where) @ DOWN
    assert shape.hits_bin(T[None], source).tolist() == [hit]


def test_hits_points_is_what_one_box_at_a_time_says(gripper: Gripper, source: Bin) -> None:
    rng = np.random.default_rng(2)
    points = source.position + rng.uniform([-0.1, -0.1, 0.0], [0.1, 0.1, 0.2], (25, 3))
    Ts = around(source, 200, seed=3)
    boxes = gripper.boxes(0.02)
    slow = []
    for T in Ts:
        hit = False
        for box in boxes:
            p = apply(invert(T @ box.T_world_box), points)
            hit |= bool((np.abs(p) <= np.asarray(box.size) / 2 + POINT_MARGIN).all(axis=1).any())
        slow.append(hit)
    assert OpenGripper.of(boxes).hits_points(Ts, points).tolist() == slow
    assert 0.05 < np.mean(slow) < 0.95


def test_nothing_to_hit_and_nobody_to_hit(gripper: Gripper, source: Bin) -> None:
    shape = OpenGripper.of(gripper.boxes(0.02))
    Ts = around(source, 3, seed=0)
    assert shape.hits_points(Ts, np.zeros((0, 3))).tolist() == [False] * 3
    assert shape.hits_points(Ts[:0], np.ones((4, 3))).shape == (0,)
    assert shape.hits_bin(Ts[:0], source).shape == (0,)


def test_a_point_between_the_jaws_is_free_and_one_in_a_finger_is_not(gripper: Gripper) -> None:
    shape = OpenGripper.of(gripper.boxes(0.02))
    points = np.array([[0.0, 0.0, -0.01], [0.0125, 0.0, -0.01]])
    for point, hit in zip(points, (False, True), strict=True):
        assert shape.hits_points(np.eye(4)[None], point[None]).tolist() == [hit]


def test_thinning_keeps_one_point_of_every_voxel() -> None:
    points = np.random.default_rng(4).uniform(-0.05, 0.05, (2000, 3))
    kept = thin(points, 0.01)
    voxels = np.floor(kept / 0.01).astype(int)
    assert len(np.unique(voxels, axis=0)) == len(kept)
    assert {tuple(v) for v in voxels} == {tuple(v) for v in np.floor(points / 0.01).astype(int)}
    assert {tuple(p) for p in kept} <= {tuple(p) for p in points}
    np.testing.assert_array_equal(kept, thin(points, 0.01))
    assert thin(np.zeros((0, 3))).shape == (0, 3)


def test_own_points_are_left_out_and_all_others_stay(bracket: Workpiece) -> None:
    T = make_transform(random_rotations(1, np.random.default_rng(5))[0], (0.4, 0.1, 0.05))
    surface, normals = bracket.sample_surface(500, seed=6)
    assert len(without_workpiece(apply(T, surface), T, bracket)) == 0
    away = apply(T, surface + 0.006 * normals)
    away = away[np.abs(bracket.mesh.nearest.signed_distance(apply(invert(T), away))) > 0.0059]
    assert len(away) > 200
    np.testing.assert_array_equal(without_workpiece(away, T, bracket), away)
