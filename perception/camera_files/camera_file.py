"""Intrinsics from a file, in the layouts that cameras and datasets come with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, invert, make_transform
from pickproof.cell.sensing.camera import Intrinsics
from pickproof.perception.camera_files.check import (
    MM,
    check_matrix,
    check_mm,
    check_pose,
    check_sigma,
    check_size,
    check_step,
    is_rigid,
)
from pickproof.perception.camera_files.layout import NEAR, VALID, Section, inner_sections
from pickproof.perception.camera_files.text import read_mapping

NEAREST_WORLD = 10.0
"""[mm] from the camera to the origin of its world, below which a translation is likely in m."""


@dataclass(frozen=True)
class CameraFile:
    """The content of a camera's file.

    Attributes:
        K: (3, 3) with the focal lengths and the principal point in [pixel].
        size: width and height in [pixel], None where not stated.
        depth_step: [m] a count of a depth image; T_world_camera: (4, 4); sigma: [m] of a measured depth; None likewise.
        source: the file, or the command line; of_image: it is written for each image, which may be a crop.
    """

    K: Array
    size: tuple[int, int] | None = None
    depth_step: float | None = None
    T_world_camera: Array | None = None
    sigma: float | None = None
    source: str | Path = "command line"
    of_image: bool = False

    def intrinsics(self, width: int, height: int, image: Path) -> Intrinsics:
        """For an image of this size.

        Raises:
            InputError: the camera is one of another size.
        """
        if self.size is not None and self.size != (width, height):
            valid = f"{self.size[0]} x {self.size[1]} as the camera has it"
            raise InputError(image, "size", f"{width} x {height}", valid)
        check_size(self.K, width, height, self.of_image or self.size is not None, self.source)
        return Intrinsics(width, height, *(float(self.K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))))


def read_camera(path: Path, image: Path | None = None, id: int | None = None) -> CameraFile:
    """A camera's JSON or YAML file; lengths in the layouts of BOP are millimetres, in ours metres.

    Args:
        image: the image it is for; of a scene_camera.json the number in its name chooses the entry.
        id: the entry of a scene_camera.json in place of that.

    Raises:
        InputError: missing, unreadable, without intrinsics, of a lens that is not yet rectified, with numbers that
            cannot be those of a camera, or with keys whose meaning is not known.
    """
    data = read_mapping(path)
    if data and all(str(key).isdigit() and isinstance(entry, dict) for key, entry in data.items()):
        return _of_scene(path, {int(key): entry for key, entry in data.items()}, image, id)
    if id is not None:
        raise InputError("command line", "--camera-id", id, f"none: {path} is of one camera")
    return _read(Section(data, path))


def _of_scene(path: Path, entries: dict[int, Any], image: Path | None, id: int | None) -> CameraFile:
    """The entry of a scene_camera.json for an image; any where all of them are the same."""
    named = id
    if id is None and image is not None and image.stem.isdigit():
        named = int(image.stem)
    if named is None and all(entry == next(iter(entries.values())) for entry in entries.values()):
        named = next(iter(entries))
    if named not in entries:
        shown = ", ".join(map(str, sorted(entries)[:12])) + (", ..." if len(entries) > 12 else "")
        found = "nothing" if named is None else named
        raise InputError(path, "image", found, f"one of {shown}; --camera-id says which")
    return _read(Section(entries[named], path, f"{named}."), of_image=True)


def _read(section: Section, of_image: bool = False) -> CameraFile:
    parts = [section, *inner_sections(section)]
    for part in parts:
        part.check_keys()
        part.check_lens()
    stated = [entry for part in parts for entry in part.matrices()]
    if not stated:
        raise InputError(section.path, section.prefix.rstrip("."), "no intrinsics", VALID)
    (name, K), *others = stated
    for other, again in others:
        if np.abs(K - again).max() > NEAR:
            raise section.bad(f"{name} and {other}", [K.tolist(), again.tolist()], "the same numbers")
    sizes = [size for part in parts for size in part.sizes()]
    if len(set(sizes)) > 1:
        raise section.bad("width, height", sizes, "one size of the image")
    size = sizes[0] if sizes else None
    check_matrix(K, section.path)
    for part in parts:
        part.check_ros(K, size)
    if size is not None:
        check_size(K, *size, True, section.path)
    sigma = section.number("sigma_m") if section.has("sigma_m") else None
    if sigma is not None:
        check_sigma(sigma, section.path, f"{section.prefix}sigma_m")
    return CameraFile(K, size, _step(section), _pose(section), sigma, section.path, of_image)


def _step(section: Section) -> float | None:
    """[m] a count, of `depth_step_m` or of BOP's `depth_scale` in mm."""
    found = None
    for key, per_metre in (("depth_scale", MM), ("depth_step_m", 1.0)):
        if section.has(key):
            step = section.number(key) / per_metre
            check_step(step, section.path, f"{section.prefix}{key}", per_metre)
            if found is not None and abs(step - found) > 1e-9 * found:
                raise section.bad("depth_scale and depth_step_m", [found, step], "the same step")
            found = step
    return found


def _pose(section: Section) -> Array | None:
    """T_world_camera (4, 4) of our own files, of BOP's w2c [mm], or of Open3D's extrinsic, column by column."""
    found: list[Array] = []
    if section.has("T_world_camera"):
        found.append(section.numbers("T_world_camera", (16,)).reshape(4, 4))
        check_pose(found[-1], section.path, f"{section.prefix}T_world_camera")
    if section.has("extrinsic"):
        T = section.numbers("extrinsic", (16,)).reshape(4, 4)
        flat = not isinstance(section.data["extrinsic"][0], list)
        check_pose(T.T if flat else T, section.path, f"{section.prefix}extrinsic")
        found.append(invert(T.T if flat else T))
    if section.has("cam_R_w2c") != section.has("cam_t_w2c"):
        raise section.bad("cam_R_w2c, cam_t_w2c", "one of them", "both, or neither")
    if section.has("cam_R_w2c"):
        found.append(invert(pose_in_mm(section, "cam_R_w2c", "cam_t_w2c", NEAREST_WORLD, zero=True)))
    if len(found) > 1 and any(np.abs(found[0] - T).max() > 1e-4 for T in found[1:]):
        raise section.bad("T_world_camera", [T.tolist() for T in found], "one pose of the camera")
    return found[0] if found else None


def pose_in_mm(section: Section, R_name: str, t_name: str, nearest: float, zero: bool = False) -> Array:
    """The transform (4, 4) in [m] of two fields of a BOP file: R row by row, t in [mm].

    Args:
        nearest, zero: see `check_mm`.
    """
    R, t = section.numbers(R_name, (9,)).reshape(3, 3), section.numbers(t_name, (3,))
    if not is_rigid(make_transform(R)):
        raise section.bad(R_name, R.ravel().tolist(), "a rotation matrix, row by row")
    check_mm(t, section.path, f"{section.prefix}{t_name}", nearest, zero)
    return make_transform(R, t / MM)
