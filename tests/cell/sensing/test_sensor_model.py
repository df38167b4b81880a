"""Laws of the sensor model: statistics of the noise, and where pixels go missing."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pickproof.cell.config import parse, read_yaml
from pickproof.cell.errors import InputError
from pickproof.cell.frames import make_transform
from pickproof.cell.geometry.bin import Box, table
from pickproof.cell.sensing.camera import Intrinsics, Render, RenderOptions, look_at, render
from pickproof.cell.sensing.sensor_model import (
    SensorConfig,
    depth_edges,
    list_presets,
    measure,
    random_sensor,
    received_intensity,
    smooth_noise,
)
from pickproof.cell.workpiece.optics import MATERIALS, Optics
from pickproof.cell.workpiece.workpiece import WorkpieceConfig
from pickproof.scenarios.config.shipped import WORKPIECES

K = Intrinsics.from_fov(200, 150, np.deg2rad(40))
CLEAN = SensorConfig(speckle_dropout=0.0, edge_dropout=0.0, flying=0.0, lateral_sigma=0.0)
GREY = Optics.of("matt_grey")
NOTHING = np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros((0, 4, 4))
DOWN = look_at((0.0, 0.0, 0.8), (0.0, 0.0, 0.0))


def plane(depth: float, incidence_deg: float = 0.0, part: bool = True, camera: Intrinsics = K) -> Render:
    """A plane that fills the image, met at `incidence_deg` by the optical axis; the depth falls with x."""
    slope = np.tan(np.deg2rad(incidence_deg))
    x = camera.rays()[..., 0]
    z = depth / (1 + slope * x)
    normal = np.array([-np.sin(np.deg2rad(incidence_deg)), 0.0, -np.cos(np.deg2rad(incidence_deg))])
    normals = np.broadcast_to(normal, (*z.shape, 3)).astype(np.float32)
    cos_view = np.abs(camera.rays() @ normal) / np.linalg.norm(camera.rays(), axis=-1)
    return Render(z, np.full(z.shape, 0 if part else -1, np.int32), normals, cos_view, np.ones(z.shape, dtype=bool))


def measured(render: Render, sensor: SensorConfig, seed: int = 0, optics: Optics | None = None) -> np.ndarray:
    return measure(render, K, np.eye(4), sensor, np.random.default_rng(seed), optics).depth


def test_switched_off_it_is_the_exact_render() -> None:
    off = SensorConfig(enabled=False)
    image = plane(0.7, 30)
    np.testing.assert_array_equal(measured(image, off), image.depth.astype(np.float32))
    assert off.projector_offset is None
    assert not off.sees_reflections(Optics.of("polished_steel"))


@pytest.mark.parametrize("preset", ["structured_light", "stereo"])
@pytest.mark.parametrize("depth", [0.4, 0.8, 1.6])
def test_axial_noise_is_the_configured_one_and_grows_with_depth_squared(preset: str, depth: float) -> None:
    clean = {"speckle_dropout": 0.0, "hole_dropout": 0.0, "lateral_sigma": 0.0}
    sensor = SensorConfig.model_validate({"preset": preset, **clean})
    frames = [measure(plane(depth), K, np.eye(4), sensor, np.random.default_rng(seed)) for seed in range(4)]
    error = np.concatenate([(frame.depth - depth).ravel() for frame in frames])
    expected = sensor.axial_floor + sensor.axial_sigma * depth**2
    assert error.std() == pytest.approx(expected, rel=0.04)
    assert frames[0].sigma == pytest.approx(expected, rel=0.01)  # and the frame says so
    assert abs(error.mean()) < 0.05 * expected


@pytest.mark.parametrize("length", [2.0, 6.0])
def test_neighbours_share_noise_over_the_correlation_length(length: float) -> None:
    field = smooth_noise((1200, 1200), length, np.random.default_rng(0))
    assert field.std() == pytest.approx(1.0, rel=0.03)
    for shift in (1, int(length), int(2 * length)):
        correlation = np.mean(field[:, :-shift] * field[:, shift:]) / field.var()
        assert correlation == pytest.approx(np.exp(-((shift / length) ** 2)), abs=0.04)


def test_the_correlated_share_is_a_share_of_the_variance() -> None:
    for share in (0.0, 0.4, 1.0):
        sensor = CLEAN.model_copy(update={"correlated_share": share, "correlation_length": 6.0})
        error = measured(plane(0.8), sensor) - 0.8
        correlation = np.mean(error[:, :-1] * error[:, 1:]) / error.var()
        assert correlation == pytest.approx(share * np.exp(-1 / 36), abs=0.05)


def test_grazing_pixels_go_missing() -> None:
    camera = Intrinsics.from_fov(100, 100, np.deg2rad(2))
    any_light = CLEAN.model_copy(update={"min_intensity": 0.0})
    share = []
    for angle in (0, 68, 75, 78, 82, 86):
        image = plane(0.6, angle, camera=camera)
        share.append(np.mean(measure(image, camera, np.eye(4), any_light, np.random.default_rng(0)).depth == 0))
    assert share[0] == share[1] == 0
    assert 0 < share[2] < share[3] < 1
    assert share[4] == share[5] == 1


def test_what_the_projector_does_not_see_and_the_sky_go_missing() -> None:
    image = plane(0.6)
    image.lit[:40] = False
    image.depth[:, :50] = 0.0
    depth = measured(image, CLEAN)
    assert (depth[:40] == 0).all() and (depth[:, :50] == 0).all()
    assert (depth[40:, 50:] > 0).all()


@pytest.mark.parametrize("baseline", [0.06, 0.12])
@pytest.mark.parametrize("height", [0.03, 0.1])
def test_the_shadow_of_a_step_has_the_width_of_the_geometry(baseline: float, height: float) -> None:
    """A step of height h at x = 0 under a camera at height z: b h / (z - h) of the floor are in the shadow."""
    camera = Intrinsics.from_fov(400, 60, np.deg2rad(30))
    ground = table((2.0, 2.0, 0.1), (0.0, 0.0, 0.0))
    step = Box("step", (1.0, 2.0, height), make_transform(t=(0.5, 0.0, height / 2)))
    image = render(*NOTHING, [ground, step], camera, DOWN, RenderOptions((baseline, 0.0, 0.0)))
    row = measure(image, camera, DOWN, CLEAN, np.random.default_rng(0)).depth[30]
    on_floor = 0.8 / camera.fx  # [m] a pixel
    width = np.count_nonzero(row == 0) * on_floor
    assert width == pytest.approx(baseline * height / (0.8 - height), abs=1.5 * on_floor)


def test_only_steps_lose_pixels_to_the_edge() -> None:
    image = plane(0.6)
    image.depth[:, 100:] = 0.5
    sensor = CLEAN.model_copy(update={"edge_dropout": 1.0})
    missing = np.flatnonzero((measured(image, sensor) == 0).any(axis=0))
    assert missing.tolist() == [99, 100]
    wide = np.flatnonzero((measured(image, sensor.model_copy(update={"edge_width": 3})) == 0).any(axis=0))
    assert wide.tolist() == [97, 98, 99, 100, 101, 102]


def test_a_steep_plane_of_coarse_pixels_is_no_edge_and_a_step_in_it_is() -> None:
    """A plane at 80 degrees falls by 15 mm a pixel of 2.6 mm, four times `edge_jump`."""
    camera = Intrinsics.from_fov(60, 80, 2 * np.arctan(30 * 0.0026 / 1.6))
    image = plane(1.6, 80, camera=camera)
    assert 1.6 / camera.fx == pytest.approx(0.0026)
    assert np.abs(np.diff(image.depth, axis=1)).min() > 2 * CLEAN.edge_jump
    sensor = CLEAN.model_copy(update={"edge_dropout": 1.0, "grazing_deg": 90.0})
    exact = image.depth.astype(np.float32)
    assert not depth_edges(exact, camera, sensor)[:, 1:-1].any()
    depth = measure(image, camera, np.eye(4), sensor, np.random.default_rng(0)).depth
    kept = (depth > 0)[:, 1:-1]
    limit = np.deg2rad(sensor.grazing_deg - 10)
    assert kept[image.cos_view[:, 1:-1] > np.cos(limit)].mean() > 0.99
    exact[40:] += 0.04
    assert depth_edges(exact, camera, sensor)[[39, 40], 1:-1].all()
    assert not depth_edges(exact, camera, sensor)[[37, 42], 1:-1].any()


def test_flying_pixels_lie_between_the_surfaces() -> None:
    image = plane(0.6)
    image.depth[:, 100:] = 0.5
    sensor = CLEAN.model_copy(update={"flying": 1.0, "edge_width": 2})
    depth = measured(image, sensor)
    at_edge, elsewhere = depth[:, 98:102], np.delete(depth, np.s_[98:102], axis=1)
    assert 0.49 < at_edge.min() < 0.53 and 0.57 < at_edge.max() < 0.61
    assert np.mean((at_edge > 0.51) & (at_edge < 0.59)) > 0.7
    assert np.minimum(np.abs(elsewhere - 0.6), np.abs(elsewhere - 0.5)).max() < 0.001


def test_speckle_and_holes_have_their_rates_and_holes_hang_together() -> None:
    def neighbours_missing(depth: np.ndarray) -> float:
        gone = depth == 0
        return float((gone[:, 1:] & gone[:, :-1]).mean() / gone.mean())

    shares, clumps = [], []
    for field in ("speckle_dropout", "hole_dropout"):
        depths = np.concatenate([measured(plane(0.6), CLEAN.model_copy(update={field: 0.1}), s) for s in range(6)])
        shares.append(np.mean(depths == 0))
        clumps.append(neighbours_missing(depths))
    assert shares == pytest.approx([0.1, 0.1], abs=0.015)
    assert clumps[0] < 0.15 and clumps[1] > 0.6


def test_the_darker_the_surface_the_more_is_missing() -> None:
    centre = (slice(20, 130), slice(60, 140))
    share = []
    for albedo in (0.5, 0.12, 0.05, 0.03, 0.02, 0.01):
        share.append(np.mean(measured(plane(0.6, 30), CLEAN, optics=Optics(albedo=albedo))[centre] == 0))
    assert share[0] == share[1] == 0
    assert 0 < share[2] < share[3] < share[4] < 1
    assert share[-1] == 1
    tilted = np.mean(measured(plane(0.6, 60), CLEAN, optics=Optics(albedo=0.05))[centre] == 0)
    assert tilted > share[2]  # less light falls on it
    elsewhere = measured(plane(0.6, 30, part=False), CLEAN, optics=Optics(albedo=0.01))
    assert (elsewhere > 0).all()  # the optics are the workpiece's, not the bin's


def test_diffuse_intensity_is_lamberts_law() -> None:
    camera = Intrinsics.from_fov(101, 101, np.deg2rad(4))
    facing, tilted = (received_intensity(plane(0.6, a, camera=camera), camera, 0.0, GREY)[50, 50] for a in (0, 50))
    assert facing == pytest.approx(GREY.albedo, rel=0.01)
    assert tilted == pytest.approx(GREY.albedo * np.cos(np.deg2rad(50)), rel=0.01)


def test_a_mirror_saturates_between_projector_and_camera_and_is_dark_elsewhere() -> None:
    mirror, sensor = Optics.of("polished_steel"), CLEAN.model_copy(update={"interreflection": 0.0})
    halfway = np.rad2deg(np.arctan(sensor.baseline / 0.6) / 2)
    facing = plane(0.6, -halfway)
    towards_camera = received_intensity(facing, K, sensor.baseline, mirror)[75, 100]
    assert towards_camera == pytest.approx(mirror.specular / (4 * mirror.roughness**2), rel=0.1)
    assert (measured(facing, sensor, optics=mirror)[70:80, 95:105] == 0).all()
    assert (measured(plane(0.6, 65), sensor, optics=mirror)[70:80, 95:105] == 0).mean() > 0.5
    assert (measured(facing, sensor, optics=GREY)[70:80, 95:105] > 0).all()


def corner(sensor: SensorConfig, optics: Optics) -> Render:
    """A floor of one workpiece and, at x = 0, its wall, so that the floor mirrors the wall."""
    floor = trimesh.creation.box((0.2, 0.2, 0.01))
    wall = trimesh.creation.box((0.01, 0.2, 0.08), transform=make_transform(t=(-0.06, 0.0, 0.04)))
    part = trimesh.util.concatenate([floor, wall])
    options = RenderOptions(sensor.projector_offset, sensor.sees_reflections(optics))
    return render(part.vertices, part.faces, np.eye(4)[None], [], K, DOWN, options)


def test_a_concave_corner_gives_patches_at_wrong_depths() -> None:
    sensor = CLEAN.model_copy(update={"interreflection": 1.0, "max_intensity": 100.0, "min_intensity": 0.0})
    shiny = Optics(albedo=0.5, specular=1.0, roughness=0.3)
    image = corner(sensor, shiny)
    assert image.reflected is not None and np.isfinite(image.reflected).any()
    depth = measured(image, sensor, optics=shiny)
    seen = (image.ids >= 0) & (depth > 0)
    wrong = seen & (np.abs(depth - image.depth) > 0.002)
    near = np.isfinite(image.reflected) & (image.reflected < 0.05)
    assert wrong[near].mean() > 0.1
    assert not wrong[seen & np.isinf(image.reflected)].any()
    assert np.abs(depth - image.depth)[seen].max() < 0.052
    alone = wrong & ~np.roll(wrong, 1, 0) & ~np.roll(wrong, -1, 0) & ~np.roll(wrong, 1, 1) & ~np.roll(wrong, -1, 1)
    assert alone.sum() < 0.1 * wrong.sum()


def test_matt_parts_and_switched_off_interreflection_cast_no_rays() -> None:
    assert corner(CLEAN, GREY).reflected is None
    off = CLEAN.model_copy(update={"interreflection": 0.0})
    assert corner(off, Optics.of("polished_steel")).reflected is None


def test_the_mirrored_ray_has_the_length_of_the_geometry() -> None:
    """Floor at z = 0.005, wall face at x = -0.055: a ray that falls by 0.8 over x comes back up with the same slope."""
    image = corner(CLEAN, Optics(specular=1.0))
    assert image.reflected is not None
    v, u = 74, np.flatnonzero(np.isfinite(image.reflected[74]) & (np.abs(image.normals[74, :, 2] + 1) < 1e-6))[0]
    slope_x, slope_y = K.rays()[v, u, :2]
    x = slope_x * image.depth[v, u]
    along = (-0.055 - x) / slope_x  # [m] of depth until the wall
    expected = along * np.sqrt(1 + slope_x**2 + slope_y**2)
    assert image.reflected[v, u] == pytest.approx(expected, abs=2e-3)


def test_the_same_seed_measures_the_same() -> None:
    for preset in list_presets():
        sensor, steel = SensorConfig.of_preset(preset), Optics.of("polished_steel")
        image = corner(sensor, steel)
        np.testing.assert_array_equal(measured(image, sensor, 3, steel), measured(image, sensor, 3, steel))
        assert (measured(image, sensor, 3, steel) != measured(image, sensor, 4, steel)).any()


def test_the_defaults_are_structured_light() -> None:
    assert SensorConfig() == SensorConfig.of_preset("structured_light")


def test_a_preset_with_single_fields_replaced() -> None:
    stereo = SensorConfig.of_preset("stereo")
    mine = parse(SensorConfig, {"preset": "stereo", "baseline": 0.095}, "mine.yaml")
    assert mine == stereo.model_copy(update={"baseline": 0.095})
    assert stereo.axial_sigma == pytest.approx(0.08 / (640 / np.tan(np.deg2rad(32.5)) * 0.055), rel=0.01)
    assert SensorConfig.model_validate(mine.model_dump()) == mine


def test_bad_names_are_said_in_one_line() -> None:
    with pytest.raises(InputError, match=r"^a\.yaml: preset: 'lidar' is not valid; expected one of: stereo, struct"):
        parse(SensorConfig, {"preset": "lidar"}, "a.yaml")
    with pytest.raises(InputError, match=r"axial: 1 is not valid; expected no such field; one of: enabled, preset"):
        parse(SensorConfig, {"preset": "stereo", "axial": 1}, "a.yaml")


def test_a_workpiece_names_its_material_or_gives_the_numbers() -> None:
    data = read_yaml(WORKPIECES / "bracket" / "workpiece.yaml")
    assert parse(WorkpieceConfig, data, "w").optics == GREY
    assert parse(WorkpieceConfig, {**data, "optics": "machined_steel"}, "w").optics == Optics.of("machined_steel")
    given = parse(WorkpieceConfig, {**data, "optics": {"albedo": 0.1, "specular": 0.2}}, "w").optics
    assert (given.albedo, given.specular) == (0.1, 0.2)
    with pytest.raises(InputError, match=r"optics: 'chrome' is not valid; expected one of: matt_grey, "):
        parse(WorkpieceConfig, {**data, "optics": "chrome"}, "w")


def test_materials_give_back_no_more_light_than_falls_on_them() -> None:
    for name in MATERIALS:
        optics = Optics.of(name)
        assert optics.albedo + optics.specular <= 1


def test_training_draws_cover_both_presets_and_rarely_cast_more_rays() -> None:
    rng = np.random.default_rng(0)
    drawn = [random_sensor(rng) for _ in range(400)]
    for preset in list_presets():
        for field, value in SensorConfig.of_preset(preset).model_dump().items():
            if isinstance(value, float) and field not in ("axial_floor", "edge_jump"):
                values = [getattr(sensor, field) for sensor in drawn]
                assert min(values) <= value <= max(values), (preset, field)
    assert 0.15 < np.mean([sensor.interreflection > 0 for sensor in drawn]) < 0.35
    assert 0.15 < np.mean([sensor.preset == "stereo" for sensor in drawn]) < 0.35
