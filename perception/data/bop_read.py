"""Depth images and poses of a BOP dataset (scene-wise format), for training and for evaluation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, invert, make_transform
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.mesh.error import MeshError
from pickproof.cell.mesh.file import read_mesh
from pickproof.cell.sensing.camera import DepthFrame, Intrinsics, render
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.camera_files.camera_file import NEAREST_WORLD, pose_in_mm
from pickproof.perception.camera_files.check import check_matrix, check_pose, check_size, check_step
from pickproof.perception.camera_files.layout import Section
from pickproof.perception.data.bop_format import (
    CAMERA,
    DATASET_INFO,
    GROUND_TRUTH,
    MM,
    MODELS_INFO,
    mask_name,
    of_sensor,
    read_json,
    read_pose,
)
from pickproof.perception.data.bop_sensor import sensor_of, split_folder
from pickproof.perception.data.noise_estimate import measured_sigma
from pickproof.perception.data.region import region_of_interest
from pickproof.perception.ps6d.cloud import roi_mask

NEAREST_PART = 50.0
"""[mm] from the camera to a workpiece, below which a translation is likely in m."""
BIN_MM = (10.0, 5000.0)
"""[mm] between which the inner lengths of a bin lie."""
SAME_SIZE = 0.01
"""Difference of edge lengths, relative to the longest, up to which a model of the dataset is the workpiece."""


@dataclass(frozen=True)
class BopImage:
    """One depth image and the true poses of one object in it.

    Attributes:
        folder: of the scene.
        scene, image, obj: ids in the dataset.
        focal: fx, fy and centre: cx, cy in [pixel].
        depth_scale: [mm] a count.
        T_world_camera: (4, 4), identity where the dataset has none.
        bin: where workpieces lie in the world, where dataset_info.json says so.
        Ts_camera_part: (n, 4, 4) in [m], of the workpiece's own CAD frame; indices: (n,) of each in scene_gt.json.
        T_model_part: (4, 4) from the workpiece's frame to that of the dataset's model.
        sensor: that names of files and folders end with, empty for the only one.
    """

    folder: Path
    scene: int
    image: int
    obj: int
    focal: tuple[float, float]
    centre: tuple[float, float]
    depth_scale: float
    T_world_camera: Array
    bin: Bin | None
    Ts_camera_part: Array
    indices: tuple[int, ...]
    T_model_part: Array
    sensor: str = ""

    def frame(self) -> DepthFrame:
        """The measured depth.

        Raises:
            InputError: no readable 16-bit image.
        """
        path = self.folder / of_sensor("depth", self.sensor) / f"{self.image:06d}.png"
        path = path if path.is_file() else path.with_suffix(".tif")
        counts = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.is_file() else None
        if counts is None or counts.dtype != np.uint16 or counts.ndim != 2:
            raise InputError(path.with_suffix(".png"), "", "missing or unreadable", "a 16-bit one-channel depth image")
        step = self.depth_scale / MM
        depth = (counts * step).astype(np.float32)
        K = Intrinsics(counts.shape[1], counts.shape[0], *self.focal, *self.centre)
        matrix = np.array([[K.fx, 0.0, K.cx], [0.0, K.fy, K.cy], [0.0, 0.0, 1.0]])
        check_size(matrix, K.width, K.height, True, self.folder / of_sensor(CAMERA, self.sensor))
        return DepthFrame(depth, K, self.T_world_camera, measured_sigma(depth, step))

    def region(self, frame: DepthFrame, workpiece: Workpiece) -> np.ndarray:
        """(h, w) bool: where workpieces may be; no ground truth enters."""
        return region_of_interest(frame, workpiece) if self.bin is None else roi_mask(frame, self.bin)

    def ids(self, frame: DepthFrame, workpiece: Workpiece) -> np.ndarray:
        """(h, w) int32: index of the instance that each pixel shows, -1 for anything else.

        By the masks of visible surfaces; where the dataset has none, where the CAD at the true pose lies within the
        workpiece's tolerance of the measured depth.
        """
        masks = self.folder / of_sensor("mask_visib", self.sensor)
        if not masks.is_dir():
            exact = render(workpiece.vertices, workpiece.faces, self.Ts_camera_part, (), frame.intrinsics, np.eye(4))
            near = (frame.depth > 0) & (np.abs(frame.depth - exact.depth) < workpiece.tolerance)
            return np.where(near, exact.ids, np.int32(-1))
        ids = np.full(frame.depth.shape, -1, np.int32)
        for i, index in enumerate(self.indices):
            path = masks / mask_name(self.image, index)
            mask = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.is_file() else None
            if mask is None or mask.shape[:2] != ids.shape:
                raise InputError(path, "", "missing, unreadable or of another size", f"a mask of {ids.shape} pixels")
            ids[(mask if mask.ndim == 2 else mask.max(2)) > 0] = i
        return ids


def read_bop(
    folder: Path, split: str | None, obj: int | None, workpiece: Workpiece, sensor: str | None = None
) -> list[BopImage]:
    """The images of a split that hold the object, by scene and image.

    Args:
        split: None where there is but one.
        obj: its id; None where the dataset has but one.
        sensor: of datasets with several, as photoneo; None where the split has depth of but one.

    Raises:
        InputError: no such dataset, split, sensor or object, or files that are not as the format has them.
    """
    obj, T_model_part = _model(folder, obj, workpiece)
    bin = _bin(folder)
    images: list[BopImage] = []
    chosen = split_folder(folder, split)
    sensor = sensor_of(chosen, sensor)
    for scene_folder in sorted(p for p in chosen.iterdir() if p.is_dir() and p.name.isdigit()):
        path = scene_folder / of_sensor(GROUND_TRUTH, sensor)
        truth = read_json(path, "true poses; hidden ones cannot be scored")
        cameras = read_json(scene_folder / of_sensor(CAMERA, sensor), "the cameras of a BOP scene")
        for key, mine in _of_object(path, truth, obj):
            images.append(_image(scene_folder, key, cameras, mine, (obj, bin, T_model_part, sensor)))
    if not images:
        raise InputError(chosen, "", f"no image of object {obj}", "scenes that hold it")
    return images


def _of_object(path: Path, truth: Any, obj: int) -> list[tuple[str, list[tuple[int, dict[str, Any]]]]]:
    """Image's key, and the index and entry of each instance of the object in it."""
    try:
        found = [
            (key, [(i, entry) for i, entry in enumerate(truth[key]) if entry.get("obj_id") == obj])
            for key in sorted(truth, key=int)
        ]
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(path, "", str(error), "lists of true poses by image, as the BOP format has them") from None
    return [(key, mine) for key, mine in found if mine]


def _image(
    folder: Path,
    key: str,
    cameras: Any,
    mine: list[tuple[int, dict[str, Any]]],
    of: tuple[int, Bin | None, Array, str],
) -> BopImage:
    obj, bin, T_model_part, sensor = of
    path = folder / of_sensor(CAMERA, sensor)
    entry = cameras.get(key) if isinstance(cameras, dict) else None
    if not isinstance(entry, dict) or any(name not in entry for name in ("cam_K", "depth_scale")):
        raise InputError(path, key, entry, "cam_K and depth_scale, as the BOP format has them")
    camera = Section(entry, path, f"{key}.")
    K = camera.numbers("cam_K", (9,)).reshape(3, 3)
    check_matrix(K, f"{path}: {key}")
    scale = camera.number("depth_scale")
    check_step(scale / MM, path, f"{key}.depth_scale")
    has_pose = camera.has("cam_R_w2c")
    if has_pose != camera.has("cam_t_w2c"):
        raise camera.bad("cam_R_w2c, cam_t_w2c", "one of them", "both, or neither")
    T = invert(pose_in_mm(camera, "cam_R_w2c", "cam_t_w2c", NEAREST_WORLD, zero=True)) if has_pose else np.eye(4)
    return BopImage(
        folder=folder,
        scene=int(folder.name),
        image=int(key),
        obj=obj,
        focal=(float(K[0, 0]), float(K[1, 1])),
        centre=(float(K[0, 2]), float(K[1, 2])),
        depth_scale=scale,
        T_world_camera=T,
        bin=bin if has_pose else None,
        Ts_camera_part=np.array([_pose(folder, key, i, entry, sensor) for i, entry in mine]) @ T_model_part,
        indices=tuple(i for i, _ in mine),
        T_model_part=T_model_part,
        sensor=sensor,
    )


def _pose(folder: Path, key: str, index: int, entry: dict[str, Any], sensor: str) -> Array:
    section = Section(entry, folder / of_sensor(GROUND_TRUTH, sensor), f"{key}.{index}.")
    for name in ("cam_R_m2c", "cam_t_m2c"):
        if not section.has(name):
            raise section.bad(name, "nothing", "an entry as the BOP format has it")
    return pose_in_mm(section, "cam_R_m2c", "cam_t_m2c", NEAREST_PART)


def _model(folder: Path, obj: int | None, workpiece: Workpiece) -> tuple[int, Array]:
    """ID of the object, and T_model_part: both frames are parallel, the workpiece's origin is the centre of its box."""
    infos = read_json(folder / "models" / MODELS_INFO, "the models of a BOP dataset")
    known = sorted(int(key) for key in infos)
    if obj is None and len(known) == 1:
        obj = known[0]
    if obj not in known:
        raise InputError("command line", "--obj", obj, f"one of: {', '.join(map(str, known))}")
    path = folder / "models" / f"obj_{obj:06d}.ply"
    if path.is_file():
        try:
            model = read_mesh(path)
        except MeshError as error:
            raise InputError(path, "", error.found, error.valid) from None
        used = model.vertices[np.unique(model.faces)] / MM
        low, high = used.min(axis=0), used.max(axis=0)
    else:
        info = infos[str(obj)]
        low = np.array([info[f"min_{axis}"] for axis in "xyz"]) / MM
        high = low + np.array([info[f"size_{axis}"] for axis in "xyz"]) / MM
    if np.abs(high - low - workpiece.extents).max() > SAME_SIZE * workpiece.extents.max():
        size, own = (" x ".join(f"{MM * e:.4g}" for e in x) for x in (high - low, workpiece.extents))
        raise InputError(path, "size", f"{size} mm", f"the model of {workpiece.name}, {own} mm, with the same axes")
    return obj, make_transform(t=(low + high) / 2)


def _bin(folder: Path) -> Bin | None:
    """The bin that our own exports name in dataset_info.json; others have none."""
    path = folder / DATASET_INFO
    entry = read_json(path, "JSON").get("bin") if path.is_file() else None
    if entry is None:
        return None
    try:
        x, y, z = (float(e) / MM for e in entry["inner"])
        T = read_pose(entry, "R_bin2w", "t_bin2w")
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(path, "bin", str(error), "inner, R_bin2w and t_bin2w in mm") from None
    check_pose(T, path, "bin")
    if not all(BIN_MM[0] <= MM * e <= BIN_MM[1] for e in (x, y, z)):
        raise InputError(path, "bin.inner", entry["inner"], f"{BIN_MM[0]:g} to {BIN_MM[1]:g} mm; in mm, is it in m?")
    if abs(T[2, 2] - 1) > 1e-9:
        raise InputError(path, "bin.R_bin2w", entry["R_bin2w"], "a bin whose floor is level in the world")
    return Bin("bin", (x, y, z), 0.0, (T[0, 3], T[1, 3], T[2, 3]), float(np.arctan2(T[1, 0], T[0, 0])))
