"""Statistics of the sensor's noise."""

from __future__ import annotations

import numpy as np
import pytest

from cell.camera import Intrinsics, Render
from cell.sensor import SensorConfig, measure

K = Intrinsics.from_fov(200, 150, np.deg2rad(40))
CLEAN = SensorConfig(speckle_dropout=0.0, edge_dropout=0.0, lateral_sigma=0.0)


def flat(depth: float, cos_view: float = 1.0) -> Render:
    shape = (K.height, K.width)
    return Render(
        np.full(shape, depth), np.full(shape, -1, np.int32), np.full(shape, cos_view), np.ones(shape, dtype=bool)
    )


def measured(render: Render, sensor: SensorConfig, seed: int = 0) -> np.ndarray:
    return measure(render, K, np.eye(4), sensor, np.random.default_rng(seed)).depth


def test_switched_off_it_is_the_exact_render() -> None:
    np.testing.assert_array_equal(measured(flat(0.7), SensorConfig(enabled=False)), np.float32(0.7))
    assert SensorConfig(enabled=False).projector_offset is None


@pytest.mark.parametrize("depth", [0.4, 0.8, 1.6])
def test_axial_noise_grows_with_depth_squared(depth: float) -> None:
    error = measured(flat(depth), CLEAN) - depth
    expected = CLEAN.axial_floor + CLEAN.axial_sigma * depth**2
    assert error.std() == pytest.approx(expected, rel=0.03)
    assert abs(error.mean()) < 4 * expected / np.sqrt(error.size)


def test_grazing_pixels_go_missing() -> None:
    share = [np.mean(measured(flat(0.6, np.cos(np.deg2rad(a))), CLEAN) == 0) for a in (0, 69, 75, 79, 81, 89)]
    assert share[0] == share[1] == 0
    assert 0 < share[2] < share[3] < 1
    assert share[4] == share[5] == 1


def test_shadow_and_sky_go_missing() -> None:
    render = flat(0.6)
    render.lit[:40] = False
    render.depth[:, :50] = 0.0
    depth = measured(render, CLEAN)
    assert (depth[:40] == 0).all() and (depth[:, :50] == 0).all()
    assert (depth[40:, 50:] > 0).all()


def test_only_edges_lose_pixels_to_the_edge() -> None:
    render = flat(0.6)
    render.depth[:, 100:] = 0.5
    depth = measured(render, SensorConfig(speckle_dropout=0.0, lateral_sigma=0.0, edge_dropout=1.0))
    missing = np.flatnonzero((depth == 0).any(axis=0))
    assert missing.tolist() == [99, 100]


def test_speckle_has_its_rate() -> None:
    depth = measured(flat(0.6), SensorConfig(speckle_dropout=0.1))
    assert np.mean(depth == 0) == pytest.approx(0.1, abs=0.01)


def test_the_same_seed_measures_the_same() -> None:
    np.testing.assert_array_equal(measured(flat(0.6), SensorConfig(), 3), measured(flat(0.6), SensorConfig(), 3))
    assert (measured(flat(0.6), SensorConfig(), 3) != measured(flat(0.6), SensorConfig(), 4)).any()
