"""Depth that is the length of the ray is told from z by the largest flat surface."""

from __future__ import annotations

import numpy as np
import pytest

from pickproof.cell.sensing.camera import Intrinsics
from pickproof.perception.data.noise_estimate import measured_sigma
from pickproof.perception.own_images.ray_length import bends_flat_surfaces, to_z
from tests.perception.own_images.test_perceive import seen

K = Intrinsics(320, 240, 450.0, 450.0, 159.5, 119.5)
LENGTH = np.linalg.norm(K.rays(), axis=-1)


def plane(tilt: float, sigma: float = 0.0) -> np.ndarray:
    """Depth (h, w) of a plane 0.9 m away, turned by `tilt` [rad] about y."""
    z = 0.9 / (K.rays() @ np.array([np.sin(tilt), 0.0, np.cos(tilt)]))
    return np.asarray(z + sigma * np.random.default_rng(0).standard_normal(z.shape))


@pytest.mark.parametrize("sigma", [0.0, 0.0003, 0.002])
@pytest.mark.parametrize("tilt", [0.0, 0.3, -0.7])
def test_a_plane_of_any_tilt(tilt: float, sigma: float) -> None:
    z = plane(tilt, sigma)
    noise = measured_sigma(z)
    assert not bends_flat_surfaces(z, K, noise)
    assert bends_flat_surfaces(z * LENGTH, K, noise)
    assert bends_flat_surfaces(z, K, noise, "range")
    assert not bends_flat_surfaces(z * LENGTH, K, noise, "range")


def test_conversion_is_exact() -> None:
    np.testing.assert_allclose(to_z(plane(0.3) * LENGTH, K), plane(0.3), rtol=1e-12)


def test_what_shows_no_plane_says_nothing() -> None:
    rng = np.random.default_rng(0)
    noise = rng.uniform(0.6, 1.0, LENGTH.shape)
    few = np.where(rng.random(LENGTH.shape) < 0.005, plane(0.0) * LENGTH, 0.0)
    step = np.where(np.arange(K.width) < 100, plane(0.2), 0.8 * plane(-0.4))
    for depth in (noise, few, step, np.zeros(LENGTH.shape)):
        assert not bends_flat_surfaces(depth, K, measured_sigma(depth))


def test_a_heap_in_its_bin() -> None:
    frame = seen()[0]
    depth = frame.depth.astype(np.float64)
    assert not bends_flat_surfaces(depth, frame.intrinsics, frame.sigma)
    assert bends_flat_surfaces(depth * np.linalg.norm(frame.intrinsics.rays(), axis=-1), frame.intrinsics, frame.sigma)
