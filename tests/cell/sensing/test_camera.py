"""Laws of rendering and of the depth frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pickproof.cell.errors import InputError
from pickproof.cell.frames import apply, from_rpy, invert, make_transform
from pickproof.cell.geometry.bin import Box, table
from pickproof.cell.sensing.camera import DEPTH_STEP, DepthFrame, Intrinsics, RenderOptions, look_at, render
from pickproof.cell.workpiece.workpiece import Workpiece

K = Intrinsics.from_fov(160, 120, np.deg2rad(40))
GROUND = table((2.0, 2.0, 0.1), (0.0, 0.0, 0.0))
DOWN = look_at((0.0, 0.0, 0.6), (0.0, 0.0, 0.0))
NOTHING = np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros((0, 4, 4))


def frame(depth: np.ndarray) -> DepthFrame:
    return DepthFrame(depth.astype(np.float32), Intrinsics(depth.shape[1], depth.shape[0], 100, 100, 3, 2), DOWN)


def test_projection_undoes_unprojection() -> None:
    depth = np.random.default_rng(0).uniform(0.3, 0.9, (K.height, K.width)).astype(np.float32)
    points, pixels = DepthFrame(depth, K, DOWN).points_camera()
    np.testing.assert_allclose(K.project(points), pixels[:, ::-1], atol=1e-9)
    np.testing.assert_allclose(points[:, 2], depth.ravel(), atol=1e-7)


def test_look_at_sees_its_target_in_the_middle() -> None:
    T = look_at((0.3, -0.4, 0.8), (0.1, 0.0, 0.1))
    np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-12)
    target = apply(invert(T), np.array([[0.1, 0.0, 0.1]]))
    np.testing.assert_allclose(K.project(target)[0], [K.cx, K.cy], atol=1e-9)
    assert target[0, 2] > 0


def test_a_plane_has_its_exact_depth() -> None:
    flat = render(*NOTHING, [GROUND], K, DOWN)
    np.testing.assert_allclose(flat.depth, 0.6, atol=1e-5)
    assert flat.lit.all() and (flat.ids == -1).all()
    tilted = DOWN @ from_rpy(rpy=(0.5, 0.2, 0.0))
    seen = render(*NOTHING, [GROUND], K, tilted)
    hit = seen.depth > 0
    points = apply(tilted, K.rays()[hit] * seen.depth[hit][:, None])
    on_top = np.abs(points[:, :2]).max(axis=1) < 0.99
    assert on_top.sum() > 1000
    np.testing.assert_allclose(points[on_top, 2], 0.0, atol=1e-5)


def test_pixels_carry_the_index_of_their_part(bracket: Workpiece) -> None:
    centres = np.array([[-0.08, 0.0, 0.02], [0.08, 0.0, 0.02], [0.0, 0.06, 0.02]])
    Ts = make_transform(np.eye(3), centres)
    image = render(bracket.vertices, bracket.faces, Ts, [GROUND], K, DOWN)
    pixels = K.project(apply(invert(DOWN), centres))
    for i, (u, v) in enumerate(np.rint(pixels).astype(int)):
        owners = image.ids[v - 2 : v + 3, u - 6 : u + 7]
        assert (owners == i).mean() > 0.6  # not all: the bracket has a hole
    points = apply(DOWN, K.rays()[image.ids == 1] * image.depth[image.ids == 1][:, None])
    local = apply(invert(Ts[1]), points)
    assert (np.abs(local) < bracket.extents / 2 + 1e-5).all()


def test_what_is_in_front_hides_what_is_behind(bracket: Workpiece) -> None:
    Ts = make_transform(np.eye(3), np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.05]]))
    image = render(bracket.vertices, bracket.faces, Ts, [GROUND], K, DOWN)
    assert (image.ids == 1).sum() > 5 * (image.ids == 0).sum()


def test_the_shadow_falls_away_from_the_projector() -> None:
    wall = Box("wall", (0.02, 0.2, 0.1), make_transform(t=(0.0, 0.0, 0.05)))
    v, u = K.height // 2, K.width // 2
    for side in (+1, -1):
        image = render(*NOTHING, [GROUND, wall], K, DOWN, RenderOptions((0.12 * side, 0.0, 0.0)))
        dark = np.flatnonzero(~image.lit[v])
        assert dark.size > 3
        assert (side * (dark - u) < 0).all()
        assert image.lit[0].all()  # beyond the end of the wall
    assert render(*NOTHING, [GROUND, wall], K, DOWN).lit.all()


def test_a_frame_comes_back_from_disk(tmp_path: Path) -> None:
    depth = np.random.default_rng(1).uniform(0.2, 1.6, (30, 40)).astype(np.float32)
    depth[3:6] = 0.0
    pose = from_rpy((0.1, 0.2, 0.3), (3.0, 0.1, 0.2))
    before = DepthFrame(depth, Intrinsics(40, 30, 90.0, 91.0, 19.5, 14.5), pose, sigma=1.1e-3)
    before.save(tmp_path / "a.png")
    after = DepthFrame.load(tmp_path / "a.png")
    np.testing.assert_allclose(after.depth, before.depth, atol=DEPTH_STEP / 2 + 1e-7)
    assert (after.depth[3:6] == 0).all()
    assert after.intrinsics == before.intrinsics and after.sigma == before.sigma
    np.testing.assert_array_equal(after.T_world_camera, before.T_world_camera)
    after.save(tmp_path / "b.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_a_frame_is_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        frame(np.ones((5, 7))).depth[0, 0] = 2.0


def test_too_far_for_the_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="depth"):
        frame(np.full((5, 7), 2.0)).save(tmp_path / "far.png")


@pytest.mark.parametrize("broken", ["json", "schema", "png", "size"])
def test_a_broken_file_is_named(tmp_path: Path, broken: str) -> None:
    path = tmp_path / "a.png"
    frame(np.ones((5, 7))).save(path)
    meta = path.with_suffix(".json")
    if broken == "json":
        meta.write_text("{")
    elif broken == "schema":
        meta.write_text(meta.read_text().replace('"schema": 1', '"schema": 99'))
    elif broken == "png":
        path.write_bytes(b"not an image")
    else:
        meta.write_text(meta.read_text().replace('"width": 7', '"width": 8'))
    with pytest.raises(InputError) as caught:
        DepthFrame.load(path)
    assert caught.value.file == str(meta if broken in ("json", "schema") else path)
