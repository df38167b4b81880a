"""One camera in every layout that is read, and files that look like it but are not to be trusted."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, about_axis, invert
from pickproof.cell.sensing.camera import Intrinsics
from pickproof.perception.camera_files.camera_file import read_camera
from tests.fuzzing.mutate import mutated, with_garbage

CAMERA = Intrinsics(640, 480, 900.5, 901.25, 322.5, 238.25)
STEP, SIGMA = 1e-4, 2e-4
POSE = about_axis((1.0, 0.0, 0.0), np.pi)
POSE[:3, 3] = 0.4, -0.05, 0.9

POSES = ("T_world_camera", "extrinsic", "cam_R_w2c", "cam_t_w2c")

Document = dict[str, Any]


def rows(K: Intrinsics) -> list[float]:
    return [K.fx, 0.0, K.cx, 0.0, K.fy, K.cy, 0.0, 0.0, 1.0]


def columns(K: Intrinsics) -> list[float]:
    return [K.fx, 0.0, 0.0, 0.0, K.fy, 0.0, K.cx, K.cy, 1.0]


def bop(K: Intrinsics) -> Document:
    names = ("fx", "fy", "cx", "cy", "width", "height")
    return {name: getattr(K, name) for name in names} | {"depth_scale": 1000 * STEP}


def bop_scene(K: Intrinsics) -> Document:
    T = invert(POSE)

    def entry() -> Document:
        pose = {"cam_R_w2c": T[:3, :3].ravel().tolist(), "cam_t_w2c": (1000 * T[:3, 3]).tolist()}
        return {"cam_K": rows(K), "depth_scale": 1000 * STEP} | pose

    return {"0": entry(), "3": entry()}


def ros(K: Intrinsics) -> Document:
    P = np.insert(np.reshape(rows(K), (3, 3)), 3, 0.0, axis=1)
    return {
        "header": {"stamp": {"sec": 12, "nanosec": 5}, "frame_id": "depth"},
        "height": K.height,
        "width": K.width,
        "distortion_model": "plumb_bob",
        "d": [0.0] * 5,
        "k": rows(K),
        "r": np.eye(3).ravel().tolist(),
        "p": P.ravel().tolist(),
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def ros_yaml(K: Intrinsics) -> Document:
    P = np.insert(np.reshape(rows(K), (3, 3)), 3, 0.0, axis=1).ravel().tolist()
    return {
        "image_width": K.width,
        "image_height": K.height,
        "camera_name": "depth",
        "camera_matrix": {"rows": 3, "cols": 3, "data": rows(K)},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0] * 5},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()},
        "projection_matrix": {"rows": 3, "cols": 4, "data": P},
    }


def realsense(K: Intrinsics) -> Document:
    size = {"width": K.width, "height": K.height}
    return size | {
        **{"ppx": K.cx, "ppy": K.cy, "fx": K.fx, "fy": K.fy},
        **{"model": "distortion.brown_conrady", "coeffs": [0.0] * 5},
    }


def open3d(K: Intrinsics) -> Document:
    return {"width": K.width, "height": K.height, "intrinsic_matrix": columns(K)}


def open3d_parameters(K: Intrinsics) -> Document:
    return {
        "class_name": "PinholeCameraParameters",
        "extrinsic": invert(POSE).T.ravel().tolist(),
        "intrinsic": open3d(K),
        "version_major": 1,
        "version_minor": 0,
    }


def opencv(K: Intrinsics) -> Document:
    """As FileStorage writes JSON; `file_storage` makes its YAML of it."""
    kind = {"type_id": "opencv-matrix", "dt": "d"}
    return {
        "calibration_time": "Thu Jan 05 10:11:12",
        "nr_of_frames": 20,
        "image_width": K.width,
        "image_height": K.height,
        "camera_matrix": kind | {"rows": 3, "cols": 3, "data": rows(K)},
        "distortion_coefficients": kind | {"rows": 5, "cols": 1, "data": [0.0] * 5},
        "avg_reprojection_error": 0.21,
    }


def own(K: Intrinsics) -> Document:
    head = {"schema": 1, "depth_step_m": STEP, "intrinsics": vars(K)}
    return head | {"T_world_camera": POSE.tolist(), "sigma_m": SIGMA}


def matrix(K: Intrinsics) -> Document:
    return {"K": np.reshape(rows(K), (3, 3)).tolist(), "image_size": [K.width, K.height], "dist_coeffs": [0.0] * 4}


LAYOUTS: dict[str, Callable[[Intrinsics], Document]] = {
    layout.__name__: layout
    for layout in (bop, bop_scene, ros, ros_yaml, realsense, open3d, open3d_parameters, opencv, own, matrix)
}


def as_json(document: Document) -> bytes:
    return json.dumps(document, indent=1, default=str).encode()


def as_yaml(document: Document) -> bytes:
    return str(yaml.safe_dump(document, sort_keys=False, default_flow_style=None)).encode()


def file_storage(document: Document) -> bytes:
    """As OpenCV writes YAML: a directive of its own, and a tag in place of `type_id`."""
    lines = ["%YAML:1.0", "---"]
    for key, value in document.items():
        if not (isinstance(value, dict) and "data" in value):
            lines.append(f"{key}: {json.dumps(value, default=str)}")
            continue
        lines.append(f"{key}: !!opencv-matrix")
        inside = (item for item in value.items() if item[0] != "type_id")
        lines += [f"   {name}: {entry if name == 'dt' else json.dumps(entry, default=str)}" for name, entry in inside]
    return ("\n".join(lines) + "\n").encode()


WRITERS: dict[str, Callable[[Document], bytes]] = {".json": as_json, ".yaml": as_yaml}


def transposed(document: Document) -> Document:
    """Matrices of nine numbers in the other order."""
    turned = copy.deepcopy(document)
    for key, value in turned.items():
        if isinstance(value, dict):
            turned[key] = transposed(value)
        elif isinstance(value, list) and np.size(value) == 9:
            M = np.reshape(value, (3, 3)).T
            turned[key] = M.tolist() if isinstance(value[0], list) else M.ravel().tolist()
    return turned


def swapped(K: Intrinsics) -> Intrinsics:
    return Intrinsics(K.width, K.height, K.fx, K.fy, K.cy, K.cx)


def halved(K: Intrinsics) -> Intrinsics:
    return Intrinsics(K.width, K.height, K.fx / 2, K.fy / 2, K.cx / 2, K.cy / 2)


def hostile(rng: np.random.Generator) -> tuple[str, bytes]:
    """Suffix and content of a camera's file; some are in order."""
    if rng.random() < 0.04:
        return str(rng.choice([".json", ".yaml"])), rng.bytes(int(rng.integers(0, 200)))
    name = str(rng.choice(list(LAYOUTS)))
    K = CAMERA if rng.random() < 0.95 else swapped(CAMERA)
    document = LAYOUTS[name](K)
    if rng.random() < 0.1:
        document = transposed(document)
    for _ in range(rng.integers(0, 3)):
        document = mutated(document, rng, whole=POSES)
    suffix = str(rng.choice(list(WRITERS)))
    write = file_storage if name == "opencv" and suffix == ".yaml" else WRITERS[suffix]
    content = write(document)
    if rng.random() < 0.25:
        content = with_garbage(content, rng)
    elif suffix == ".json" and rng.random() < 0.1:
        content = content[: rng.integers(len(content))]
    return suffix, content


def check(path: Path) -> str:
    """`read` where a file gives CAMERA, `refused` where it gives a reason.

    Raises:
        AssertionError: another camera.
    """
    try:
        camera = read_camera(path, Path("000003.png"))
        found = camera.intrinsics(CAMERA.width, CAMERA.height, path)
    except InputError as error:
        assert str(error).strip() and error.valid
        return "refused"
    off = np.abs(np.array(list(vars(found).values())) - list(vars(CAMERA).values()))
    assert off.max() < 1e-6, f"read another camera: {found}"
    assert camera.depth_step is None or abs(camera.depth_step / STEP - 1) < 1e-6, camera.depth_step
    assert camera.sigma is None or abs(camera.sigma / SIGMA - 1) < 1e-6, camera.sigma
    same_pose(camera.T_world_camera)
    return "read"


def same_pose(T: Array | None) -> None:
    assert T is None or np.abs(T - POSE).max() < 1e-6, T
