"""Intrinsics from a file, in the layouts that cameras and datasets come with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cell.camera import Intrinsics
from cell.config import read_yaml
from cell.errors import InputError
from cell.frames import Array
from perception.bop_format import MM

VALID = (
    "fx, fy, cx, cy [pixel], as BOP's camera.json has them, cam_K, a ROS CameraInfo, "
    "or what is written beside a depth image of pickproof"
)


@dataclass(frozen=True)
class CameraFile:
    """What a camera's file says.

    Attributes:
        K: (3, 3) with the focal lengths and the principal point in [pixel].
        size: width and height in [pixel], None where it does not say.
        depth_step: [m] a count of a depth image; T_world_camera: (4, 4); sigma: [m] of a measured depth; None likewise.
    """

    K: Array
    size: tuple[int, int] | None = None
    depth_step: float | None = None
    T_world_camera: Array | None = None
    sigma: float | None = None

    def intrinsics(self, width: int, height: int, image: Path) -> Intrinsics:
        """For an image of this size.

        Raises:
            InputError: the camera is one of another size.
        """
        if self.size is not None and self.size != (width, height):
            valid = f"{self.size[0]} x {self.size[1]} as the camera has it"
            raise InputError(image, "size", f"{width} x {height}", valid)
        return Intrinsics(width, height, self.K[0, 0], self.K[1, 1], self.K[0, 2], self.K[1, 2])


def read_camera(path: Path) -> CameraFile:
    """A camera's JSON or YAML file; lengths in the layouts of BOP are millimetres, in ours metres.

    Raises:
        InputError: missing, unreadable, without intrinsics, or of a lens that is not yet rectified.
    """
    data = read_yaml(path)  # YAML holds JSON
    try:
        K = _matrix(data)
        width, height = (_first(data, "intrinsics", name, f"image_{name}") for name in ("width", "height"))
        size = None if width is None or height is None else (int(width), int(height))
        step = data.get("depth_step_m")
        if step is None and "depth_scale" in data:
            step = float(data["depth_scale"]) / MM
        T, sigma = data.get("T_world_camera"), data.get("sigma_m")
        pose = None if T is None else np.reshape(np.asarray(T, dtype=np.float64), (4, 4))
        lens = _numbers(data.get("distortion_coefficients", data.get("D", data.get("d", []))))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(path, "", f"{type(error).__name__}: {error}", VALID) from None
    if np.abs(lens).max(initial=0.0) > 1e-9:
        raise InputError(path, "distortion", lens.tolist(), "none: rectify the image, and give the rectified camera")
    return checked(CameraFile(K, size, step, pose, sigma), path)


def checked(camera: CameraFile, source: str | Path) -> CameraFile:
    """The camera, if its numbers can be true.

    Raises:
        InputError: they cannot.
    """
    if not (np.isfinite(camera.K).all() and min(camera.K[0, 0], camera.K[1, 1]) > 0):
        raise InputError(source, "intrinsics", camera.K.tolist(), "finite numbers, fx and fy above 0")
    if camera.depth_step is not None and not (np.isfinite(camera.depth_step) and camera.depth_step > 0):
        raise InputError(source, "depth_scale", camera.depth_step, "a number above 0")
    T = camera.T_world_camera
    if T is not None and not is_rigid(T):
        raise InputError(source, "T_world_camera", T.tolist(), "a 4 x 4 rigid transform")
    return camera


def is_rigid(T: Array) -> bool:
    """Whether T (4, 4) is a rotation and a translation, as far as four digits tell."""
    R = T[:3, :3]
    whole = bool(np.isfinite(T).all()) and np.allclose(T[3], [0, 0, 0, 1])
    return whole and np.allclose(R @ R.T, np.eye(3), atol=1e-3) and float(np.linalg.det(R)) > 0


def _matrix(data: dict[str, Any]) -> Array:
    inner = data.get("intrinsics", data)
    if "fx" in inner:
        fx, fy, cx, cy = (float(inner[name]) for name in ("fx", "fy", "cx", "cy"))
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    for name in ("camera_matrix", "cam_K", "K", "k"):
        if name in data:
            return _numbers(data[name]).reshape(3, 3)
    raise KeyError("no intrinsics")


def _numbers(entry: Any) -> Array:
    """A list of numbers, or what ROS writes: a mapping with `data`."""
    return np.asarray(entry["data"] if isinstance(entry, dict) else entry, dtype=np.float64).ravel()


def _first(data: dict[str, Any], inner: str, name: str, other: str) -> Any:
    return data.get(inner, data).get(name, data.get(other))
