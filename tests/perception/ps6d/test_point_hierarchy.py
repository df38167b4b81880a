from __future__ import annotations

import numpy as np
import pytest

from pickproof.cell.frames import Array, random_rotations
from pickproof.perception.ps6d.cloud import Cloud
from pickproof.perception.ps6d.point_hierarchy import (
    K_BLOCK,
    K_SET,
    K_UP,
    NORMAL_NEIGHBOURS,
    VOXELS,
    Graph,
    PointTree,
    build_graph,
    least_axis,
    local_frames,
    normals_of,
    voxel_sample,
)


def bumpy(n: int = 4000, seed: int = 0) -> tuple[Array, Array]:
    """Points on a wavy sheet over a few units, and unit vectors towards a camera far above."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-1, 1, (n, 2))
    z = 0.15 * np.sin(3 * xy[:, 0]) * np.cos(2 * xy[:, 1] + 0.3) + 0.1 * xy[:, 0] ** 2
    points = np.column_stack([xy, z])
    view = np.array([0.3, -0.2, 8.0]) - points
    return points, view / np.linalg.norm(view, axis=1, keepdims=True)


def cloud_of(points: Array, view: Array) -> Cloud:
    return Cloud(points, view, np.zeros((len(points), 2), int), np.zeros(3), 1.0)


def graph(n: int = 4000, seed: int = 0) -> Graph:
    out = build_graph(cloud_of(*bumpy(n)), np.random.default_rng(seed))
    assert out is not None
    return out


def test_one_point_of_every_occupied_voxel() -> None:
    points, _ = bumpy()
    voxel = 0.1
    for seed in range(5):
        chosen = voxel_sample(points, voxel, np.random.default_rng(seed))
        assert (np.diff(chosen) > 0).all()
        offset = np.random.default_rng(seed).uniform(0, voxel, 3)  # the grid is drawn first
        cells = np.floor((points - points.min(axis=0) + offset) / voxel).astype(int)
        assert len(np.unique(cells[chosen], axis=0)) == len(chosen) == len(np.unique(cells, axis=0))


def test_voxel_samples_are_random_and_repeatable() -> None:
    points, _ = bumpy()
    a, b, c = (voxel_sample(points, 0.2, np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, c)
    assert voxel_sample(np.zeros((0, 3)), 0.1, np.random.default_rng(0)).shape == (0,)
    assert voxel_sample(points[:1], 0.1, np.random.default_rng(0)).tolist() == [0]


def test_neighbours_are_the_nearest_and_are_repeated_when_there_are_too_few() -> None:
    points, _ = bumpy(60)
    d, i = PointTree(points).nearest(points, 7)
    brute = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.testing.assert_allclose(d, np.sort(brute, axis=1)[:, :7], atol=1e-6)
    np.testing.assert_allclose(np.take_along_axis(brute, i, axis=1), d, atol=1e-6)
    d, i = PointTree(points[:3]).nearest(points, 5)
    assert i.shape == (60, 5)
    np.testing.assert_array_equal(i[:, 2:], np.repeat(i[:, 2:3], 3, axis=1))
    assert PointTree(points[:1]).nearest(points, 4)[1].tolist() == [[0] * 4] * 60


def normals(points: Array, view: Array) -> Array:
    return normals_of(points, PointTree(points).nearest(points, NORMAL_NEIGHBOURS)[1], view)


def test_normals_of_a_plane_and_a_sphere() -> None:
    rng = np.random.default_rng(3)
    R = random_rotations(1, rng)[0]
    plane = np.column_stack([rng.uniform(-1, 1, (2000, 2)), np.zeros(2000)]) @ R.T
    for side in (1.0, -1.0):  # turned to the camera, on whichever side it stands
        n = normals(plane, np.tile(side * R[:, 2], (2000, 1)))
        np.testing.assert_allclose(n, np.tile(side * R[:, 2], (2000, 1)), atol=1e-6)
    ball = rng.standard_normal((6000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    n = normals(ball, ball)
    assert np.rad2deg(np.arccos(np.clip((n * ball).sum(1), -1, 1))).max() < 10
    assert np.rad2deg(np.arccos(np.clip((n * ball).sum(1), -1, 1))).mean() < 2


def test_normals_face_the_camera() -> None:
    points, view = bumpy()
    n = normals(points, view)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1, atol=1e-9)
    assert ((n * view).sum(1) >= 0).all()


def frames(points: Array, view: Array, queries: np.ndarray) -> Array:
    return local_frames(points, normals(points, view), queries, PointTree(points))[0]


def test_frames_are_right_handed_with_the_normal_as_z() -> None:
    points, view = bumpy()
    queries = np.arange(0, len(points), 7)
    F = frames(points, view, queries)
    np.testing.assert_allclose(np.swapaxes(F, 1, 2) @ F, np.tile(np.eye(3), (len(F), 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(F), 1, atol=1e-9)
    np.testing.assert_allclose(F[:, :, 2], normals(points, view)[queries], atol=1e-12)


def test_frames_turn_with_the_cloud() -> None:
    points, view = bumpy()
    queries = np.arange(0, len(points), 7)
    F = frames(points, view, queries)
    for R in random_rotations(5, np.random.default_rng(4)):
        turned = frames(points @ R.T, view @ R.T, queries)
        same = np.abs(turned - R @ F).max(axis=(1, 2)) < 1e-4
        assert same.mean() > 0.995  # but for a sign or an axis that hangs on rounding
        np.testing.assert_allclose(turned[:, :, 2], F[:, :, 2] @ R.T, atol=1e-6)


def test_frames_exist_where_the_neighbourhood_has_no_direction() -> None:
    """On a line along the normal there is no tangent direction; any will do, but it must be one."""
    points = np.column_stack([np.zeros((50, 2)), np.linspace(-0.1, 0.1, 50)])
    F = local_frames(points, np.tile([0.0, 0.0, 1.0], (50, 1)), np.arange(50), PointTree(points))[0]
    np.testing.assert_allclose(np.swapaxes(F, 1, 2) @ F, np.tile(np.eye(3), (50, 1, 1)), atol=1e-9)


def test_levels_are_nested() -> None:
    g = graph()
    below = {tuple(p) for p in g.points}
    sizes = [len(g.points)]
    for level in g.levels:
        here = {tuple(p) for p in level.points}
        assert here <= below
        sizes.append(len(level.points))
        below = here
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > 3 * sizes[1] > 9 * sizes[2]
    np.testing.assert_array_equal(bumpy()[0][g.source].astype(np.float32), g.levels[0].points)


def test_indices_point_into_the_right_level() -> None:
    g = graph()
    below = g.points
    for i, level in enumerate(g.levels):
        n = len(level.points)
        assert level.down.shape == (n, K_SET) and level.down.max() < len(below)
        assert level.block.shape == (n, K_BLOCK) and level.block.max() < n
        np.testing.assert_array_equal(below[level.down[:, 0]], level.points)  # the nearest is the point itself
        np.testing.assert_array_equal(level.block[:, 0], np.arange(n))
        reach = np.linalg.norm(below[level.down] - level.points[:, None], axis=2)
        assert (np.diff(reach, axis=1) > -1e-6).all()
        if i:
            assert level.up.shape == (len(below), K_UP) and level.up.max() < n
            np.testing.assert_allclose(level.up_weights.sum(1), 1, atol=1e-6)
            distance = np.linalg.norm(level.points[level.up] - below[:, None], axis=2)
            assert (np.diff(distance, axis=1) > -1e-6).all()
            assert (np.diff(level.up_weights, axis=1) < 1e-6).all()  # nearer counts more
        below = level.points


def test_the_density_does_not_depend_on_the_number_of_measured_points() -> None:
    dense, sparse = graph(20_000), graph(5_000)
    ratio = len(dense.levels[0].points) / len(sparse.levels[0].points)
    assert 0.8 < ratio < 1.25
    area = 4.0
    assert 0.4 < len(dense.levels[0].points) * VOXELS[1] ** 2 / area < 2.5


def test_a_seed_gives_one_graph() -> None:
    a, b, c = graph(seed=5), graph(seed=5), graph(seed=6)
    for x, y in zip((a.points, a.normals, a.source), (b.points, b.normals, b.source), strict=True):
        np.testing.assert_array_equal(x, y)
    for x, y in zip(a.levels, b.levels, strict=True):
        for name in ("points", "frames", "down", "block", "up", "up_weights"):
            np.testing.assert_array_equal(getattr(x, name), getattr(y, name))
    assert not np.array_equal(a.source, c.source)


@pytest.mark.parametrize("n", [0, 1, 5, 63])
def test_too_few_points_give_none(n: int) -> None:
    points, view = bumpy()
    assert build_graph(cloud_of(points[:n], view[:n]), np.random.default_rng(0)) is None


def test_a_speck_of_a_cloud_still_has_every_level() -> None:
    """Many points within one voxel of the coarse levels."""
    rng = np.random.default_rng(7)
    points = np.column_stack([rng.uniform(0, 0.3, (600, 2)), np.zeros(600)])
    g = build_graph(cloud_of(points, np.tile([0.0, 0.0, 1.0], (600, 1))), rng)
    assert g is not None
    assert all(len(level.points) >= 1 and np.isfinite(level.frames).all() for level in g.levels)


def test_the_least_axis_is_that_of_the_eigenvalue_solver_and_survives_degenerate_input():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(200, 32, 3)) * [1.0, 0.7, 0.05] @ np.linalg.qr(rng.normal(size=(200, 3, 3)))[0]
    C = np.swapaxes(X, 1, 2) @ X
    cosine = np.abs((least_axis(C) * np.linalg.eigh(C)[1][:, :, 0]).sum(1))
    assert (cosine > 1 - 1e-9).all()
    flat = np.stack([np.zeros((3, 3)), np.eye(3), np.diag([1.0, 0, 0]), np.diag([2.0, 2.0, 0.0])])
    axes = least_axis(flat)
    assert np.isfinite(axes).all() and np.allclose(np.linalg.norm(axes, axis=1), 1)
    assert abs(axes[3, 2]) > 1 - 1e-9
