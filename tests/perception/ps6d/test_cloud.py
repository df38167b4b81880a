from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pickproof.cell.frames import apply, invert, make_transform
from pickproof.cell.geometry.bin import Bin, Box
from pickproof.cell.sensing.camera import DepthFrame, Intrinsics, look_at, render
from pickproof.cell.sensing.sensor_model import SensorConfig, measure
from pickproof.perception.data.scenes import View, heap_bin, overhead_view, random_view, render_heap
from pickproof.perception.ps6d.cloud import Cloud, roi_mask, scene_cloud
from tests.perception.small_heaps import bracket, small_heaps


def views() -> list[View]:
    rng = np.random.default_rng(0)
    return [overhead_view(bracket()), *(random_view(bracket(), rng) for _ in range(2))]


@pytest.mark.parametrize("i", range(3))
def test_the_mask_keeps_the_parts_and_removes_the_bin(i: int) -> None:
    """Against the instance ids of the exact image, which perception never sees."""
    view, rng = views()[i], np.random.default_rng(i)
    exact = render_heap(bracket(), small_heaps()[0], view)
    frame = measure(exact, view.intrinsics, view.T_world_camera, view.sensor, rng)
    mask = roi_mask(frame, heap_bin(bracket()))
    measured = frame.depth > 0
    part = measured & (exact.ids >= 0)
    assert mask[part].mean() > 0.97
    assert mask[measured & ~part].mean() < 0.02
    assert not mask[~measured].any()


def test_an_empty_bin_leaves_nothing_but_noise() -> None:
    view = overhead_view(bracket())
    for sensor in (SensorConfig(enabled=False), SensorConfig.model_validate({})):
        exact = render_heap(bracket(), np.zeros((0, 4, 4)), view)
        frame = measure(exact, view.intrinsics, view.T_world_camera, sensor, np.random.default_rng(0))
        assert roi_mask(frame, heap_bin(bracket())).mean() < 1e-3


def test_turned_bins_have_turned_regions() -> None:
    """A box that fills a bin's inside is kept, one beside the bin is not, however the bin stands."""
    camera = Intrinsics.from_fov(160, 120, 0.5)
    T_world_camera = look_at(np.array([0.4, 0.1, 0.9]), np.array([0.4, 0.1, 0.0]))
    for yaw in (0.0, 0.7):
        bin = Bin("bin", (0.2, 0.1, 0.06), 0.006, (0.4, 0.1, 0.0), yaw)
        inside = Box("inside", (0.19, 0.09, 0.02), bin.T_world_bin @ make_transform(t=(0, 0, 0.01)))
        beside = Box("beside", (0.19, 0.02, 0.02), bin.T_world_bin @ make_transform(t=(0, 0.08, 0.01)))
        for box, kept in ((inside, 1.0), (beside, 0.0)):
            exact = render(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 4, 4)), [box], camera, T_world_camera)
            frame = DepthFrame(exact.depth.astype(np.float32), camera, T_world_camera)
            assert roi_mask(frame, bin)[frame.depth > 0].mean() == kept


def test_the_cloud_is_the_measured_points_in_units() -> None:
    view = views()[1]
    exact = render_heap(bracket(), small_heaps()[1], view)
    frame = measure(exact, view.intrinsics, view.T_world_camera, view.sensor, np.random.default_rng(1))
    mask = roi_mask(frame, heap_bin(bracket()))
    cloud = scene_cloud(frame, mask, bracket().unit)
    assert len(cloud.points) == mask.sum() > 1000
    np.testing.assert_allclose(cloud.points.mean(axis=0), 0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(cloud.view, axis=1), 1, atol=1e-12)
    back = cloud.to_camera(cloud.points)
    u, v = np.rint(frame.intrinsics.project(back)).astype(int).T
    np.testing.assert_array_equal(np.stack([v, u], 1), cloud.pixels)
    np.testing.assert_allclose(back[:, 2], frame.depth[v, u], atol=1e-7)
    np.testing.assert_allclose(np.cross(back, cloud.view), 0, atol=1e-9)  # the camera is at the origin
    assert ((back * cloud.view).sum(1) < 0).all()
    surface = apply(invert(view.T_world_camera) @ small_heaps()[1], bracket().sample_surface(5000)[0])
    gaps = cKDTree(surface.reshape(-1, 3)).query(back)[0]
    assert np.quantile(gaps, 0.95) < 0.002


def test_normalising_is_undone_exactly() -> None:
    rng = np.random.default_rng(2)
    cloud = Cloud(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2), int), rng.standard_normal(3), 0.056)
    points = rng.standard_normal((50, 3))
    np.testing.assert_allclose((cloud.to_camera(points) - cloud.origin) / cloud.unit, points, atol=1e-12)
    twice = replace(cloud, unit=2 * cloud.unit)
    np.testing.assert_allclose(
        twice.to_camera(points) - cloud.origin, 2 * (cloud.to_camera(points) - cloud.origin), atol=1e-12
    )


def test_an_empty_mask_gives_an_empty_cloud() -> None:
    view = overhead_view(bracket())
    frame = DepthFrame(np.zeros((480, 640), np.float32), view.intrinsics, view.T_world_camera)
    cloud = scene_cloud(frame, roi_mask(frame, heap_bin(bracket())), bracket().unit)
    assert cloud.points.shape == (0, 3)
    np.testing.assert_array_equal(cloud.origin, 0)
