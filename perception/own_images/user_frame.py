"""A user's own depth image or point cloud as a DepthFrame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, apply, invert
from pickproof.cell.geometry.point_file import FORMATS, read_point_file, sensor_pose
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import UNITS, Workpiece
from pickproof.perception.camera_files.camera_file import CameraFile, read_camera
from pickproof.perception.camera_files.check import FARTHEST, check_matrix, check_pose
from pickproof.perception.data.bop_format import MM
from pickproof.perception.data.noise_estimate import measured_sigma
from pickproof.perception.own_images.ray_length import bends_flat_surfaces, to_z
from pickproof.perception.own_images.virtual_camera import depth_image

IMAGES, ARRAYS = (".png", ".tif", ".tiff"), (".npy", ".npz")
NEAREST = 0.05
"""[m] below which the median distance of a scene cannot lie, nor beyond FARTHEST; the unit is another."""
STEEPEST = 3.7
"""Most that x/z and y/z of a cloud in a camera's frame can be: half of an angle of view of 150 deg."""
LOOKS_LIKE = {
    "z": "depth looks like ray length, not z: a flat surface of {} is bent; --depth-is range converts",
    "range": "depth looks like z, not ray length: --depth-is range bends a flat surface of {}; leave it out",
}
LEAST_PIXELS = 16
"""Pixels along the workpiece's longest side below which its pose cannot be seen."""


@dataclass(frozen=True)
class Options:
    """The user's description of the input; None where not given.

    Attributes:
        camera: file of the intrinsics; focal: fx, fy and centre: cx, cy in [pixel] in its place.
        camera_id: entry of a scene_camera.json; None for that of the image's number.
        depth_scale: [mm] a count of an image of integers.
        unit: of numbers that are not integers: m, cm or mm.
        depth_is: z, or range: the length of the ray.
        pose: file of the 4 x 4 transform T_world_camera in [m]; of a cloud the world is its own frame.
        sigma: [m] standard deviation of a measured depth.
    """

    camera: Path | None = None
    focal: tuple[float, float] | None = None
    centre: tuple[float, float] | None = None
    camera_id: int | None = None
    depth_scale: float | None = None
    unit: str | None = None
    depth_is: str = "z"
    pose: Path | None = None
    sigma: float | None = None


def read_frame(
    path: Path, options: Options, workpiece: Workpiece, warn: Callable[[str], None] = lambda _: None
) -> DepthFrame:
    """The depth frame of an image or a cloud.

    Args:
        warn: is told what looks wrong but can be right.

    Raises:
        InputError: a file cannot be read or says too little, or its numbers cannot be true of this workpiece.
    """
    suffix = path.suffix.lower()
    if suffix not in (*IMAGES, *ARRAYS, *FORMATS):
        raise InputError(path, "", f"a file *{suffix}", f"one of: {', '.join((*IMAGES, *ARRAYS, *FORMATS))}")
    if not path.is_file():
        raise InputError(path, "", "missing file", "a depth image or a point cloud")
    values = _image(path) if suffix in IMAGES else _array(path) if suffix in ARRAYS else read_point_file(path)
    is_cloud = values.shape[-1] == 3 and (values.ndim == 3 or suffix not in IMAGES)
    _check_options(path, options, is_cloud, values.dtype.kind == "f")
    frame = _of_cloud(path, values.reshape(-1, 3), options) if is_cloud else _of_depth(path, values, options, warn)
    _check_scale(path, frame, workpiece, "--unit" if is_cloud or values.dtype.kind == "f" else "--depth-scale")
    return frame


def _image(path: Path) -> np.ndarray:
    values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if values is None or values.ndim != 2 or values.dtype not in (np.uint16, np.float32):
        what = "unreadable" if values is None else f"{values.dtype} with shape {values.shape}"
        raise InputError(path, "", what, "one channel of 16-bit integers, or of 32-bit floats in a TIFF")
    return np.asarray(values)


def _array(path: Path) -> np.ndarray:
    valid = "depth (h, w), or points (n, 3) or (h, w, 3); in an NPZ under the name depth or points"
    try:
        with path.open("rb") as file:
            stored = np.load(file, allow_pickle=False)
            if isinstance(stored, np.ndarray):
                values = stored
            else:
                name = next((n for n in ("depth", "points") if n in stored.files), None)
                values = np.zeros(0) if name is None else stored[name]
    except (OSError, ValueError, EOFError) as error:
        raise InputError(path, "", str(error), valid) from None
    if values.dtype.kind not in "uif" or not (values.ndim == 2 or (values.ndim == 3 and values.shape[2] == 3)):
        raise InputError(path, "", f"{values.dtype} of shape {values.shape}", valid)
    return values if values.dtype.kind in "ui" and values.ndim == 2 else values.astype(np.float64)


def _check_options(path: Path, options: Options, is_cloud: bool, is_float: bool) -> None:
    """Refuse options that would be passed over."""
    what = "a cloud" if is_cloud else "depth in floats" if is_float else "depth in integers"
    if options.depth_scale is not None and (is_cloud or is_float):
        raise InputError("command line", "--depth-scale", options.depth_scale, f"none: {path} is {what}; --unit says")
    if options.unit is not None and not (is_cloud or is_float):
        raise InputError("command line", "--unit", options.unit, f"none: {path} is {what}; --depth-scale says")
    if options.depth_is != "z" and is_cloud:
        raise InputError("command line", "--depth-is", options.depth_is, f"z: {path} is {what}")
    if options.camera_id is not None and (is_cloud or options.focal is not None):
        raise InputError("command line", "--camera-id", options.camera_id, "to stand beside --camera scene_camera.json")


def _of_depth(path: Path, values: np.ndarray, options: Options, warn: Callable[[str], None]) -> DepthFrame:
    camera = _camera(path, options)
    height, width = values.shape
    K = camera.intrinsics(width, height, path)
    is_float = values.dtype.kind == "f"
    scale = camera.depth_step if options.depth_scale is None else options.depth_scale / MM
    step = UNITS[options.unit or "m"] if is_float else scale
    if step is None:
        raise InputError(path, "--depth-scale", "missing", "millimetres a count, as 1 or 0.1")
    depth = values.astype(np.float64) * step
    depth = np.where(np.isfinite(depth) & (depth > 0), depth, 0.0).astype(np.float32)
    if not depth.any():
        raise InputError(path, "", "no pixel with a depth above 0", "a measured scene")
    _check_distance(path, float(np.median(depth[depth > 0])), "--unit" if is_float else "--depth-scale")
    pose = _pose(options.pose) if options.pose is not None else camera.T_world_camera
    sigma = options.sigma or camera.sigma or measured_sigma(depth, 0.0 if is_float else step)
    if bends_flat_surfaces(depth, K, sigma, options.depth_is):
        warn(LOOKS_LIKE[options.depth_is].format(path))
    if options.depth_is == "range":
        depth = to_z(depth, K).astype(np.float32)
    return DepthFrame(depth, K, np.eye(4) if pose is None else pose, sigma)


def _camera(path: Path, options: Options) -> CameraFile:
    """From the options, or from the JSON file beside the image."""
    if options.focal is not None and options.centre is not None:
        (fx, fy), (cx, cy) = options.focal, options.centre
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        check_matrix(K, "command line")
        return CameraFile(K)
    beside = path.with_suffix(".json")
    if options.camera is None and not beside.is_file():
        raise InputError(path, "intrinsics", "missing", "--camera FILE, or --fx --fy --cx --cy")
    return read_camera(options.camera or beside, path, options.camera_id)


def _of_cloud(path: Path, points: Array, options: Options) -> DepthFrame:
    points = points[np.isfinite(points).all(1) & points.any(1)] * UNITS[options.unit or "m"]
    if len(points) < 64:
        raise InputError(path, "", f"{len(points)} finite points", "64 or more")
    T = _pose(options.pose) if options.pose is not None else _stored_pose(path, points, UNITS[options.unit or "m"])
    points_camera = apply(invert(T), points)
    ahead = points_camera[:, 2] > 1e-6
    if ahead.mean() < 0.99:
        share = f"{100 * (1 - ahead.mean()):.0f} % of the points behind the camera"
        raise InputError(path, "z", share, "z forward from the camera; else say where it stood with --camera-pose")
    middle = float(np.median(points_camera[:, 2]))
    _check_distance(path, middle, "--unit")
    near = points_camera[ahead & (points_camera[:, 2] < 10 * middle)]
    frame = depth_image(near, T)
    return frame if options.sigma is None else DepthFrame(frame.depth, frame.intrinsics, T, options.sigma)


def _stored_pose(path: Path, points: Array, unit: float) -> Array:
    """T_world_camera (4, 4) [m] of the cloud's file, identity without one.

    A PCD file's VIEWPOINT is where the sensor stood in the cloud's frame. Some programs write points in the sensor's
    frame beside it, so it counts only where the points cannot be meant so.

    Raises:
        InputError: it may be either, or neither.
    """
    T = sensor_pose(path)
    if T is None:
        return np.eye(4)
    T[:3, 3] *= unit
    if np.linalg.norm(T[:3, 3]) > FARTHEST:
        raise InputError(path, "VIEWPOINT", T[:3, 3].tolist(), f"a sensor within {FARTHEST:g} m; is --unit right?")
    if not _can_be_seen(apply(invert(T), points)) or _can_be_seen(points):
        valid = (
            "a sensor that sees the points from there, and not from the origin too; --camera-pose says where it stood"
        )
        raise InputError(path, "VIEWPOINT", np.round(T, 6).tolist(), valid)
    return T


def _can_be_seen(points: Array) -> bool:
    """Whether points (n, 3) [m] can be those of a camera at the origin, z forward."""
    x, y, z = points.T
    before = (z > 1e-6) & (np.abs(x) < STEEPEST * z) & (np.abs(y) < STEEPEST * z)
    return bool(before.mean() > 0.99) and NEAREST < float(np.median(z)) < FARTHEST


def _pose(path: Path) -> Array:
    """T_world_camera (4, 4): JSON, YAML, text or NPY of 16 numbers."""
    valid = "a 4 x 4 rigid transform T_world_camera in m, row by row"
    try:
        if path.suffix == ".npy":
            T = np.load(path, allow_pickle=False)
        else:
            text = path.read_text(encoding="utf-8")
            T = np.array(text.translate(str.maketrans("[],;", "    ")).split(), dtype=np.float64)
        T = np.reshape(T, (4, 4)).astype(np.float64)
    except (OSError, ValueError) as error:
        raise InputError(path, "", str(error), valid) from None
    check_pose(T, path, "")
    return T


def _check_distance(path: Path, metres: float, option: str) -> None:
    if not NEAREST < metres < FARTHEST:
        valid = f"{NEAREST} to {FARTHEST:g} m; is {option} right?"
        raise InputError(path, "median distance", f"{metres:.4g} m", valid)


def _check_scale(path: Path, frame: DepthFrame, workpiece: Workpiece, option: str) -> None:
    """The workpiece at the scene's distance is neither a dot nor larger than the image."""
    middle = float(np.median(frame.depth[frame.depth > 0]))
    _check_distance(path, middle, option)
    K = frame.intrinsics
    longest = float(workpiece.extents.max())
    pixels = K.fx * longest / middle
    if not LEAST_PIXELS <= pixels <= 2 * np.hypot(K.width, K.height):
        shown = f"{MM * longest:.4g} mm of {workpiece.name} over {pixels:.0f} pixels at {middle:.3g} m"
        raise InputError(path, "scale", shown, f"{LEAST_PIXELS} pixels or more, in the image; is {option} right?")
