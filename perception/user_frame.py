"""A user's own depth image or point cloud as a DepthFrame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from cell.camera import DepthFrame
from cell.errors import InputError
from cell.frames import Array, apply, invert
from cell.point_file import FORMATS, read_point_file
from cell.workpiece import UNITS, Workpiece
from perception.bop_format import MM
from perception.camera_file import CameraFile, checked, is_rigid, read_camera
from perception.depth_noise import measured_sigma
from perception.virtual_camera import depth_image

IMAGES, ARRAYS = (".png", ".tif", ".tiff"), (".npy", ".npz")
NEAREST, FARTHEST = 0.05, 20.0
"""[m] between which the median distance of a scene lies; outside, the unit is another."""
LEAST_PIXELS = 16
"""Pixels along the workpiece's longest side below which its pose cannot be seen."""


@dataclass(frozen=True)
class Options:
    """What the user said of the input; None where nothing was said.

    Attributes:
        camera: file of the intrinsics; focal: fx, fy and centre: cx, cy in [pixel] in its place.
        depth_scale: [mm] a count of an image of integers.
        unit: of numbers that are not integers: m, cm or mm.
        pose: file of the 4 x 4 transform T_world_camera in [m]; of a cloud the world is its own frame.
        sigma: [m] standard deviation of a measured depth.
    """

    camera: Path | None = None
    focal: tuple[float, float] | None = None
    centre: tuple[float, float] | None = None
    depth_scale: float | None = None
    unit: str | None = None
    pose: Path | None = None
    sigma: float | None = None


def read_frame(path: Path, options: Options, workpiece: Workpiece) -> DepthFrame:
    """The depth frame of an image or a cloud.

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
    frame = _of_cloud(path, values.reshape(-1, 3), options) if is_cloud else _of_depth(path, values, options)
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


def _of_depth(path: Path, values: np.ndarray, options: Options) -> DepthFrame:
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
    pose = _pose(options.pose) if options.pose is not None else camera.T_world_camera
    sigma = options.sigma or camera.sigma or measured_sigma(depth, 0.0 if is_float else step)
    return DepthFrame(depth, K, np.eye(4) if pose is None else pose, sigma)


def _camera(path: Path, options: Options) -> CameraFile:
    """From the options, or from the JSON file beside the image."""
    if options.focal is not None and options.centre is not None:
        (fx, fy), (cx, cy) = options.focal, options.centre
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        return checked(CameraFile(K), "command line")
    beside = path.with_suffix(".json")
    if options.camera is None and not beside.is_file():
        raise InputError(path, "intrinsics", "missing", "--camera FILE, or --fx --fy --cx --cy")
    return read_camera(options.camera or beside)


def _of_cloud(path: Path, points: Array, options: Options) -> DepthFrame:
    points = points[np.isfinite(points).all(1) & points.any(1)] * UNITS[options.unit or "m"]
    if len(points) < 64:
        raise InputError(path, "", f"{len(points)} finite points", "64 or more")
    T = _pose(options.pose) if options.pose is not None else np.eye(4)
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
    if not is_rigid(T):
        raise InputError(path, "", T.tolist(), valid)
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
