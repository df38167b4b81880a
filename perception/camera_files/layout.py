"""Intrinsics in the layouts of cameras, libraries and datasets (docs/reference/camera-files.md lists them)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array
from pickproof.perception.camera_files.keys import (
    CENTRES,
    DEPTH,
    FLAGS,
    FOCAL,
    HEIGHT,
    LENS,
    LENS_MODEL,
    MATRIX,
    PINHOLE,
    POSE,
    PROJECTION,
    REALSENSE_PINHOLE,
    RECTIFICATION,
    SIZE,
    SKEW,
    UNDERSTOOD,
    WIDTH,
    is_unknown,
)

RECTIFY = "rectify the image, and give the rectified camera"
VALID = (
    "fx, fy, cx, cy [pixel], as BOP's camera.json has them, cam_K, a ROS CameraInfo, a file of OpenCV, RealSense or "
    "Open3D, or what is written beside a depth image of pickproof"
)
OF_MATRIX = {"rows", "cols", "data", "dt", "type_id"}
"""Keys of a matrix as ROS and OpenCV write it."""
NEAR = 1e-3
"""[pixel] within which two statements of the same number agree."""


class Section:
    """One mapping of a camera's file; its numbers, or an InputError that names the key."""

    def __init__(self, data: dict[str, Any], path: Path, prefix: str = "") -> None:
        self.data, self.path, self.prefix = data, path, prefix

    def bad(self, key: str, value: object, valid: str) -> InputError:
        """The error for a key whose value is not valid."""
        return InputError(self.path, f"{self.prefix}{key}", value, valid)

    def has(self, key: str) -> bool:
        """Whether the mapping states this key."""
        return self.data.get(key) is not None

    def number(self, key: str) -> float:
        """The finite number at a key, or an InputError."""
        value = self.data[key]
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < 1e15:
            raise self.bad(key, value, "a finite number")
        return float(value)

    def numbers(self, key: str, counts: tuple[int, ...] = ()) -> Array:
        """Those of a list, flat or of rows, or of what ROS and OpenCV write: a mapping with `data`.

        Args:
            counts: how many there may be; empty for any.
        """
        entry = self.data[key]
        shape: list[Any] | None = None
        if isinstance(entry, dict):
            shape = [entry.get(name) for name in ("rows", "cols") if name in entry]
            entry = entry.get("data") if set(entry) <= OF_MATRIX else None
        flat = _flat(entry)
        whole = flat is not None and (not counts or len(flat) in counts)
        if shape is not None and flat is not None:
            whole &= all(type(n) is int for n in shape) and (len(shape) < 2 or shape[0] * shape[1] == len(flat))
        if flat is None or not whole:
            valid = f"{' or '.join(map(str, counts))} finite numbers" if counts else "a list of finite numbers"
            raise self.bad(key, self.data[key], valid)
        return np.array(flat, dtype=np.float64)

    def check_keys(self) -> None:
        """Refuse keys that are not known and may change what the others mean."""
        for key, value in self.data.items():
            if not isinstance(key, str) or (key not in UNDERSTOOD and is_unknown(key, value)):
                valid = f"no such key, for it may change what the others mean; understood: {', '.join(UNDERSTOOD)}"
                raise self.bad(str(key), value, valid)

    def matrices(self) -> list[tuple[str, Array]]:
        """Every statement of K (3, 3), with the key that it stands under."""
        found = []
        for key in MATRIX:
            if self.has(key) and not _is_section(key, self.data[key]):
                found.append((key, self._matrix(key)))
        for names in CENTRES:
            wanted = (*FOCAL, *names)
            if any(self.has(name) for name in names) and all(self.has(name) for name in wanted):
                fx, fy, cx, cy = (self.number(name) for name in wanted)
                found.append((", ".join(wanted), np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])))
            elif any(self.has(name) for name in names):
                missing = ", ".join(name for name in wanted if not self.has(name))
                raise self.bad(missing, "nothing", f"a value beside {', '.join(n for n in wanted if self.has(n))}")
        if any(self.has(name) for name in FOCAL) and not any(self.has(n) for names in CENTRES for n in names):
            raise self.bad("cx, cy", "nothing", "the principal point beside fx and fy")
        return found

    def _matrix(self, key: str) -> Array:
        K = self.numbers(key, (9,)).reshape(3, 3)
        is_flat = isinstance(self.data[key], list) and not isinstance(self.data[key][0], list)
        if key != "intrinsic_matrix" or not is_flat:
            return K
        if np.abs(K[:2, 2]).max() > 0 and np.abs(K[2, :2]).max() == 0:
            valid = "9 numbers column by column, as Open3D has them; this looks like row order: name it cam_K"
            raise self.bad(key, self.data[key], valid)
        return K.T

    def sizes(self) -> list[tuple[int, int]]:
        """Every statement of width and height."""
        found = [tuple(self.numbers(key, (2,))) for key in SIZE if self.has(key)]
        for width, height in zip(WIDTH, HEIGHT, strict=True):
            if self.has(width) != self.has(height):
                missing, there = (height, width) if self.has(width) else (width, height)
                raise self.bad(missing, "nothing", f"a value beside {there}")
            if self.has(width):
                found.append((self.number(width), self.number(height)))
        for size in found:
            if not all(x == int(x) and 0 < x < 100_000 for x in size):
                raise self.bad("width, height", list(map(float, size)), "whole numbers of pixels, above 0")
        # a CameraInfo that was never filled in has 0 x 0, which is refused above
        return [(int(w), int(h)) for w, h in found]

    def check_lens(self) -> None:
        """Refuse a lens that is no pinhole."""
        for key in LENS:
            if not self.has(key):
                continue
            entry = self.data[key]
            if isinstance(entry, dict) and "data" not in entry:
                inner = Section(entry, self.path, f"{self.prefix}{key}.")
                inner.check_keys()
                inner.check_lens()
                continue
            values = self.numbers(key) if isinstance(entry, (list, dict)) else np.array([self.number(key)])
            if np.abs(values).max(initial=0.0) > 1e-9:
                raise self.bad(key, entry, f"no distortion: {RECTIFY}")
        for key in LENS_MODEL:
            value = self.data.get(key)
            known = value in REALSENSE_PINHOLE if isinstance(value, int) else _model(value) in PINHOLE
            if value is not None and (isinstance(value, bool) or not known):
                raise self.bad(key, value, f"the model of a pinhole with or without distortion of 0: {RECTIFY}")
        for key, wanted in zip(FLAGS, (False, True), strict=True):
            if self.has(key) and self.data[key] != wanted:
                raise self.bad(key, self.data[key], f"{str(wanted).lower()}: {RECTIFY}")
        for key in SKEW:
            if self.has(key) and abs(self.number(key)) > NEAR:
                raise self.bad(key, self.data[key], "0: rows and columns of the image at right angles")

    def check_ros(self, K: Array, size: tuple[int, int] | None) -> None:
        """Refuse a CameraInfo whose image was rectified otherwise, binned or cut out of a larger one."""
        for key in RECTIFICATION:
            if self.has(key):
                R = self.numbers(key, (9,)).reshape(3, 3)
                if np.abs(R).max() > 0 and np.abs(R - np.eye(3)).max() > 1e-6:
                    raise self.bad(key, self.data[key], f"the identity: {RECTIFY}, whose K is P[:3, :3]")
        for key in PROJECTION:
            if self.has(key):
                P = self.numbers(key, (12,)).reshape(3, 4)
                if np.abs(P).max() > 0 and (np.abs(P[:, :3] - K).max() > NEAR or np.abs(P[:, 3]).max() > 1e-6):
                    raise self.bad(key, self.data[key], f"K and a column of 0: {RECTIFY}")
        for key in ("binning_x", "binning_y"):
            if self.has(key) and self.number(key) not in (0, 1):
                raise self.bad(key, self.data[key], "0 or 1; give the camera of the binned image")
        if self.has("roi"):
            self._check_roi(size)

    def _check_roi(self, size: tuple[int, int] | None) -> None:
        roi = self.data["roi"]
        if not isinstance(roi, dict):
            raise self.bad("roi", roi, "a mapping as ROS writes it")
        inner = Section(roi, self.path, f"{self.prefix}roi.")
        for key in ("x_offset", "y_offset"):
            if inner.has(key) and inner.number(key) != 0:
                raise inner.bad(key, roi[key], "0; give the camera of the image that was cut out")
        cut = tuple(inner.number(key) if inner.has(key) else 0 for key in ("width", "height"))
        if cut != (0, 0) and cut != size:
            raise inner.bad("width, height", list(cut), "0, or the size of the image; give the camera of the cut image")


def inner_sections(section: Section) -> list[Section]:
    """The mappings `intrinsics` and `intrinsic` in which some layouts keep them.

    Raises:
        InputError: they hold what stands outside of them: depth, pose, or one more such mapping.
    """
    keys = [key for key in ("intrinsics", "intrinsic") if _is_section(key, section.data.get(key))]
    found = [Section(section.data[key], section.path, f"{section.prefix}{key}.") for key in keys]
    for inner in found:
        for key in (*DEPTH, *POSE, "intrinsics", "intrinsic"):
            if inner.has(key):
                raise inner.bad(key, inner.data[key], f"{key} outside of {inner.prefix.rstrip('.')}")
    return found


def _is_section(key: str, value: Any) -> bool:
    return key in ("intrinsics", "intrinsic") and isinstance(value, dict) and "data" not in value


def _model(value: Any) -> str:
    """`distortion.brown_conrady` as pyrealsense2 prints it, and `Brown Conrady`, are brown_conrady."""
    return str(value).lower().replace("distortion.", "").replace("-", "_").replace(" ", "_").strip()


def _flat(entry: Any) -> list[float] | None:
    """The numbers of a list or of a list of equally long lists; None where it holds anything else."""
    if not isinstance(entry, list):
        return None
    if entry and all(isinstance(row, list) for row in entry):
        if len({len(row) for row in entry}) != 1:
            return None
        entry = [value for row in entry for value in row]
    for value in entry:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < 1e15:
            return None
    return [float(value) for value in entry]
