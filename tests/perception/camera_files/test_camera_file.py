"""Cameras that are not what they look like: each is refused with what it looks like."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickproof.cell.errors import InputError
from pickproof.cell.frames import invert, make_transform
from pickproof.cell.sensing.camera import Intrinsics
from pickproof.perception.camera_files.camera_file import read_camera
from tests.fuzzing.cameras import (
    CAMERA,
    POSE,
    Document,
    bop,
    bop_scene,
    columns,
    file_storage,
    halved,
    open3d,
    open3d_parameters,
    opencv,
    own,
    realsense,
    ros,
    rows,
    swapped,
)

FILE = Path("camera.json")


def read(document: Document, folder: Path, image: str = "depth.png") -> Intrinsics:
    path = folder / FILE
    path.write_text(json.dumps(document))
    return read_camera(path, Path(image)).intrinsics(CAMERA.width, CAMERA.height, Path(image))


def plain(**values: Any) -> Document:
    return {"cam_K": rows(CAMERA)} | values


def with_K(*changes: tuple[int, float]) -> Document:
    K = rows(CAMERA)
    for i, value in changes:
        K[i] = value
    return {"cam_K": K}


WRONG_MATRICES: list[tuple[Document, str]] = [
    ({"cam_K": columns(CAMERA)}, "looks like column order: transpose it"),
    ({"intrinsic_matrix": rows(CAMERA)}, "looks like row order: name it cam_K"),
    (with_K((8, 2.0)), "row by row"),
    (with_K((8, 0.0)), "row by row"),
    (with_K((6, 3.0)), "row by row"),
    (with_K((1, 4.0)), "skew"),
    (with_K((0, -900.0)), "above 0"),
    (with_K((0, 90.0)), "alike, within a factor of 2"),
    ({"cam_K": rows(swapped(CAMERA))}, "cx along the width and cy along the height; they look swapped"),
    (bop(swapped(CAMERA)), "they look swapped"),
    ({"cam_K": rows(halved(CAMERA))}, "is this the camera of an image of 324 x 239"),
    ({"cam_K": rows(Intrinsics(0, 0, 1801, 1802, 639.5, 479.5))}, "is this the camera of an image of 1280 x 960"),
    ({"cam_K": rows(Intrinsics(0, 0, 0.9, 0.9, 0.5, 0.5))}, "principal point at 0.4 to 0.6"),
    (with_K((0, 30.0), (4, 30.0)), "angle of view in deg.*2 to 150"),
    (with_K((0, 9e5), (4, 9e5)), "angle of view in deg.*2 to 150"),
    (bop(CAMERA) | {"cx": 0.32}, "principal point at 0.05 to 0.95"),
    (bop(CAMERA) | {"width": 1280}, "principal point|1280 x 480"),
    (bop(CAMERA) | {"image_width": 320, "image_height": 240}, "one size of the image"),
    (bop(CAMERA) | {"cam_K": rows(halved(CAMERA))}, "fx, fy, cx, cy.*the same numbers"),
    (bop(CAMERA) | {"fx": "900.5"}, "fx.*a finite number"),
    (bop(CAMERA) | {"height": None}, "height.*beside width"),
    ({"fx": 900, "fy": 900}, "cx, cy"),
    ({"fx": 900, "fy": 900, "cx": 320}, "cy"),
    ({"cam_K": rows(CAMERA)[:8]}, "9 finite numbers"),
]


@pytest.mark.parametrize(("document", "message"), WRONG_MATRICES)
def test_a_matrix_that_no_camera_has(document: Document, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        read(document, tmp_path)


def test_a_crop_states_its_size(tmp_path: Path) -> None:
    """A principal point off the middle is taken from a file that says which image it is of."""
    crop = Intrinsics(640, 480, 900.0, 900.0, 120.0, 400.0)
    with pytest.raises(InputError, match="Of a crop, the camera's file states width and height"):
        read({"cam_K": rows(crop)}, tmp_path)
    assert read({"cam_K": rows(crop), "width": 640, "height": 480}, tmp_path) == crop


@pytest.mark.parametrize(
    "key",
    [
        *("distortion_coefficients", "distortion", "dist_coeffs", "distCoeffs", "dist", "coeffs", "D", "d"),
        *("distortion_coeffs", "k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"),
    ],
)
def test_a_lens_under_any_key(key: str, tmp_path: Path) -> None:
    single = len(key) == 2
    for value, right in ((0.0, True), (-0.35, False)):
        document = plain(**{key: value if single else [value, 0.0, 0.0, 0.0, 0.0]})
        if right:
            assert read(document, tmp_path) == CAMERA
        else:
            with pytest.raises(InputError, match=f"{key}.*rectify the image, and give the rectified camera"):
                read(document, tmp_path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"distortion": {"k1": 0.1}}, "distortion.k1.*rectify"),
        ({"distortion_model": "equidistant"}, "distortion_model.*pinhole"),
        ({"model": 5}, "model.*pinhole"),
        ({"fisheye_model": 1}, "fisheye_model.*rectify"),
        ({"rectified": False}, "rectified.*rectify"),
        ({"k9": 0.1}, "k9.*no unknown key.*known: camera_matrix"),
        ({"x_offset": 64}, "x_offset.*no unknown key"),
        ({"k7": "0.1"}, "k7.*no unknown key"),
        ({"lens": {"coefficient": 0.1}}, "lens.*no unknown key"),
        ({"unit": "mm"}, "unit.*no unknown key"),
        ({"depth_scale": 0.0001}, "depth_scale.*in mm, is it in m"),
        ({"depth_step_m": 0.05}, "depth_step_m.*in m, is it in mm"),
        ({"depth_scale": 0}, "depth_scale.*above 0"),
        ({"sigma_m": 0.12}, "sigma_m.*in mm"),
        (
            {"T_world_camera": make_transform(POSE[:3, :3], 1000 * POSE[:3, 3]).tolist()},
            "T_world_camera.*in m, is it in mm",
        ),
        ({"T_world_camera": POSE.T.tolist()}, "T_world_camera.*column order"),
        ({"cam_R_w2c": POSE[:3, :3].ravel().tolist(), "cam_t_w2c": [0.4, 0, 0.9]}, "cam_t_w2c.*in mm, is it in m"),
        ({"cam_R_w2c": POSE[:3, :3].ravel().tolist()}, "cam_t_w2c.*both"),
    ],
)
def test_keys_that_change_what_numbers_mean(changes: Document, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        read(plain(**changes), tmp_path)


def test_names_and_times_say_nothing_of_the_intrinsics(tmp_path: Path) -> None:
    harmless = {"serial_number": 4711, "name": "left", "comment": "of Monday", "timestamp": 12.5, "maker": "ACME"}
    assert read(plain(**harmless, distortion_model="plumb_bob"), tmp_path) == CAMERA


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"binning_x": 2}, "binning_x"),
        ({"roi": {"x_offset": 10, "y_offset": 0, "width": 640, "height": 480}}, "roi.x_offset"),
        ({"roi": {"x_offset": 0, "y_offset": 0, "width": 320, "height": 480}}, "roi"),
        ({"r": POSE[:3, :3].ravel().tolist()}, "r:.*rectify"),
        ({"p": [800.0, 0, 322.5, 0, 0, 800, 238.25, 0, 0, 0, 1, 0]}, "p:.*rectify"),
        ({"d": [0.1, 0, 0, 0, 0]}, "d:.*rectify"),
    ],
)
def test_a_camera_info_of_another_image(changes: Document, message: str, tmp_path: Path) -> None:
    assert read(ros(CAMERA), tmp_path) == CAMERA
    with pytest.raises(InputError, match=message):
        read(ros(CAMERA) | changes, tmp_path)


def test_a_realsense_lens(tmp_path: Path) -> None:
    assert read(realsense(CAMERA), tmp_path) == CAMERA
    with pytest.raises(InputError, match=r"coeffs.*rectify"):
        read(realsense(CAMERA) | {"coeffs": [0.1, 0, 0, 0, 0]}, tmp_path)


def test_a_file_storage(tmp_path: Path) -> None:
    path = tmp_path / "camera.yml"
    path.write_bytes(file_storage(opencv(CAMERA)))
    assert path.read_text().startswith("%YAML:1.0\n---\n") and "!!opencv-matrix" in path.read_text()
    assert read_camera(path).size == (640, 480)
    path.write_text('<?xml version="1.0"?>\n<opencv_storage></opencv_storage>')
    with pytest.raises(InputError, match=r"XML.*JSON or YAML; OpenCV's FileStorage"):
        read_camera(path)


def test_the_pose_of_open3d_and_our_own(tmp_path: Path) -> None:
    for document in (open3d_parameters(CAMERA), own(CAMERA)):
        (tmp_path / FILE).write_text(json.dumps(document))
        np.testing.assert_allclose(read_camera(tmp_path / FILE).T_world_camera, POSE, atol=1e-12)
    assert read(open3d(CAMERA), tmp_path) == CAMERA


def test_a_scene_camera_holds_one_camera_an_image(tmp_path: Path) -> None:
    document = bop_scene(CAMERA)
    assert read(document, tmp_path) == CAMERA  # both entries are the same
    document["3"]["cam_K"][0] = document["3"]["cam_K"][4] = 950.0
    assert read(document, tmp_path, "000003.png").fx == 950.0
    assert read(document, tmp_path, "000000.png").fx == CAMERA.fx
    for image in ("depth.png", "000007.png"):
        with pytest.raises(InputError, match=r"one of 0, 3; --camera-id says which"):
            read(document, tmp_path, image)
    path = tmp_path / FILE
    assert read_camera(path, Path("depth.png"), 3).K[0, 0] == 950.0
    np.testing.assert_allclose(read_camera(path, id=0).T_world_camera, POSE, atol=1e-12)
    assert np.allclose(invert(POSE)[:3, 3] * 1000, document["0"]["cam_t_w2c"])
    path.write_text(json.dumps(bop(CAMERA)))
    with pytest.raises(InputError, match=r"--camera-id.*of one camera"):
        read_camera(path, id=0)


@pytest.mark.parametrize("text", ['{"fx": 900, "fx": 901}', '{"cam_K": [1', "", "[]", "\x00", "{" * 3000, "a: b"])
def test_what_is_no_camera(text: str, tmp_path: Path) -> None:
    (tmp_path / FILE).write_text(text)
    with pytest.raises(InputError, match=FILE.name):
        read_camera(tmp_path / FILE)
