"""A cloud as a depth image, the noise of depth, and where workpieces may lie."""

from __future__ import annotations

import numpy as np
import pytest

from pickproof.cell.frames import about_axis, apply
from pickproof.cell.sensing.camera import DEPTH_SIGMA, DepthFrame, Intrinsics
from pickproof.cell.sensing.sensor_model import SensorConfig, measure
from pickproof.perception.data.noise_estimate import measured_sigma
from pickproof.perception.data.region import find_plane, largest_face, region_of_interest
from pickproof.perception.data.scenes import overhead_view, render_heap, tilted_view
from pickproof.perception.own_images.virtual_camera import depth_image, find_grid
from tests.perception.small_heaps import bracket, small_heaps

K = Intrinsics(200, 150, 310.0, 290.0, 101.3, 70.8)


def surface(slopes: np.ndarray) -> np.ndarray:
    """Points (n, 3) of a bumpy surface 0.8 m away along rays of these slopes (n, 2)."""
    z = 0.8 + 0.02 * np.sin(9 * slopes[:, 0]) * np.cos(7 * slopes[:, 1])
    return np.column_stack([slopes * z[:, None], z])


def test_the_pixels_of_a_camera_are_found_again() -> None:
    """Of a cloud from K with holes in it: the same depth at the same rays, to rounding."""
    rng = np.random.default_rng(0)
    points = surface(K.rays().reshape(-1, 3)[rng.random(K.width * K.height) < 0.7, :2])
    frame = depth_image(points[rng.permutation(len(points))], np.eye(4))
    assert (frame.intrinsics.fx, frame.intrinsics.fy) == pytest.approx((K.fx, K.fy), rel=1e-6)
    again = frame.points_camera()[0]
    assert len(again) == len(points)
    order, other = (np.lexsort(np.round(p / p[:, 2:], 7).T[:2]) for p in (points, again))
    np.testing.assert_allclose(again[other], points[order], atol=1e-6)


def test_a_cloud_without_pixels_becomes_a_surface() -> None:
    """Random rays: no grid; the image is filled, and its points lie on the surface to half a pixel's slope."""
    rng = np.random.default_rng(0)
    slopes = rng.uniform(-0.3, 0.3, (40_000, 2))
    assert find_grid(slopes[:3000, 0], 400.0) is None
    frame = depth_image(surface(slopes), np.eye(4))
    inner = frame.depth[4:-4, 4:-4]
    assert (inner > 0).mean() > 0.85
    points = frame.points_camera()[0]
    off = np.abs(points[:, 2] - surface(points[:, :2] / points[:, 2:])[:, 2])
    assert off.max() < 0.02 * 9 / frame.intrinsics.fx  # steepest slope times a pixel


def test_what_lies_behind_is_hidden() -> None:
    """Two sheets on the same rays, 50 mm apart: the nearer one is the image."""
    slopes = K.rays().reshape(-1, 3)[:, :2]
    near = surface(slopes)
    far = near * ((near[:, 2:] + 0.05) / near[:, 2:])
    frame = depth_image(np.concatenate([far, near]), np.eye(4))
    assert frame.depth[frame.depth > 0].max() < near[:, 2].max() + 1e-5


@pytest.mark.parametrize("sigma", [0.0003, 0.001])
def test_noise_is_measured(sigma: float) -> None:
    rng = np.random.default_rng(1)
    v, u = np.mgrid[:200, :300]
    plane = 0.7 + 0.001 * u - 0.0005 * v
    noisy = np.where(rng.random(plane.shape) < 0.1, 0, plane + sigma * rng.standard_normal(plane.shape))
    assert measured_sigma(noisy) == pytest.approx(sigma, rel=0.05)
    assert measured_sigma(plane) == DEPTH_SIGMA
    assert measured_sigma(np.round(plane, 3), step=0.001) >= 0.001 / np.sqrt(12)
    assert measured_sigma(np.zeros((4, 4))) == DEPTH_SIGMA


def test_a_plane_is_found_with_nothing_behind_it() -> None:
    rng = np.random.default_rng(2)
    turn = about_axis((1.0, 0.0, 0.0), 0.3)
    floor = apply(turn, np.column_stack([rng.uniform(-0.2, 0.2, (3000, 2)), np.full(3000, 0.9)]))
    higher = apply(turn, np.column_stack([rng.uniform(-0.1, 0.1, (5000, 2)), np.full(5000, 0.85)]))
    noise = 0.0002 * rng.standard_normal((8000, 3))
    points = np.concatenate([floor, higher]) + noise
    plane = find_plane(points, 0.002, np.random.default_rng(0), 0.02)
    most = find_plane(points, 0.002, np.random.default_rng(0), 1.0)
    assert plane is not None and most is not None
    for found, z in ((plane, 0.9), (most, 0.85)):  # the larger sheet has the floor behind it
        np.testing.assert_allclose(found.normal, -turn[:3, 2], atol=1e-3)
        assert found.offset == pytest.approx(z, abs=1e-4)


def test_the_largest_face_of_the_bracket() -> None:
    """Its underside, 56 x 18 mm less what is cut out of it (collision boxes of its YAML), and the hole."""
    underside = 0.020 * 0.012 + 0.036 * 0.018
    assert largest_face(bracket(), 0.0005) == pytest.approx(underside, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("heap", [0, 1, 2])
def test_the_region_keeps_the_parts_and_little_else(heap: int) -> None:
    for view in (overhead_view(bracket()), tilted_view(bracket(), np.random.default_rng(heap))):
        exact = render_heap(bracket(), small_heaps()[heap], view)
        frame = measure(exact, view.intrinsics, view.T_world_camera, view.sensor, np.random.default_rng(0))
        region = region_of_interest(frame, bracket())
        part = (exact.ids >= 0) & (frame.depth > 0)
        assert region[part].mean() > 0.98
        assert part[region].mean() > 0.6
        assert (region & (frame.depth == 0)).sum() == 0
        np.testing.assert_array_equal(region, region_of_interest(frame, bracket()))


def test_a_region_needs_no_floor() -> None:
    """Parts alone, as cut out by other software: nothing is taken away but strays."""
    view = overhead_view(bracket(), SensorConfig(enabled=False))
    exact = render_heap(bracket(), small_heaps()[0], view)
    depth = np.where(exact.ids >= 0, exact.depth, 0).astype(np.float32)
    frame = DepthFrame(depth, view.intrinsics, view.T_world_camera)
    assert region_of_interest(frame, bracket())[depth > 0].mean() > 0.98


def test_a_crop_looks_along_the_same_rays() -> None:
    low, high, grow = np.array([40, 30]), np.array([90, 80]), 3
    cropped = K.cropped(low, high, grow)
    assert (cropped.width, cropped.height) == (150, 150)
    block = K.rays()[30:80, 40:90]
    np.testing.assert_allclose(cropped.rays().reshape(50, 3, 50, 3, 3).mean((1, 3)), block, atol=1e-12)
