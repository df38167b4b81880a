"""Settled scenes as a BOP dataset: measured depth, exact poses, masks and visibility by ray casting."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from pickproof.cell.child_process import single_threaded_children
from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, invert
from pickproof.cell.sensing.camera import Intrinsics
from pickproof.cell.sensing.sensor_model import SensorConfig, measure
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.perception.data.bop_format import (
    CAMERA,
    DATASET_INFO,
    GROUND_TRUTH,
    GROUND_TRUTH_INFO,
    MM,
    camera_entry,
    mask_name,
    pose_entry,
    read_json,
    scene_folder,
    write_json,
)
from pickproof.perception.data.bop_models import OBJECT, write_models
from pickproof.perception.data.overlay import png
from pickproof.perception.data.scenes import View, heap_bin, overhead_view, render_heap, tilted_view

FINEST = 0.05
"""[mm] a count of the depth image, doubled until the farthest point fits into 16 bit."""
TARGET_VISIBILITY = 0.1
"""Visible fraction from which an instance is a target (test_targets_bop19.json)."""


@dataclass(frozen=True)
class Export:
    """What is written.

    Attributes:
        workpiece: its name.
        folder: of the dataset; split: `train`, `val` or `test`, or one of these with a suffix, as `train_pbr`.
        views: images of a scene: the cell's view, then others with the camera moved (`tilted_view`).
        sensor: noise of the depth.
        first_seed: with index of scene and image, the seed of views and noise.
        command: that made it.
    """

    workpiece: str
    folder: Path
    split: str
    views: int
    sensor: SensorConfig
    first_seed: int
    command: str


def export_bop(
    export: Export, heaps: list[Array], workers: int = 1, tick: Callable[[int], None] = lambda _: None
) -> None:
    """Write heaps Ts_world_part (n, 4, 4) as scenes 0, 1, ...; those that are complete in the folder are kept.

    Args:
        tick: called with the number of scenes written.

    Raises:
        InputError: the folder holds another dataset.
    """
    workpiece = load_workpiece(export.workpiece)
    _begin(export, workpiece)
    split = export.folder / export.split
    missing = [i for i in range(len(heaps)) if not (scene_folder(split, i) / GROUND_TRUTH_INFO).is_file()]
    tick(len(heaps) - len(missing))
    with single_threaded_children():
        pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
        try:
            todo = pool.map(_write_scene, repeat(export), missing, [heaps[i] for i in missing])
            for done, _ in enumerate(todo, len(heaps) - len(missing) + 1):
                tick(done)
        finally:
            pool.shutdown(cancel_futures=True)
    if export.split.split("_")[0] == "test":
        _write_targets(export, len(heaps))


def depth_scale(workpiece: Workpiece) -> float:
    """[mm] a count of the depth images of a workpiece's heaps."""
    farthest = MM * 1.5 * 1.3 * workpiece.heap.camera_distance  # the edge of the image of the farthest view
    return float(FINEST * 2 ** max(0, int(np.ceil(np.log2(farthest / (FINEST * 65535))))))


def _begin(export: Export, workpiece: Workpiece) -> None:
    """Models, camera.json and dataset_info.json, or a check that those in the folder are of the same export."""
    path = export.folder / DATASET_INFO
    made_of = {
        "views": export.views,
        "first_seed": export.first_seed,
        "sensor": export.sensor.model_dump(),
        "command": export.command,
    }
    info: dict[str, Any] = {"name": workpiece.name, "splits": {}}
    if path.is_file():
        info = read_json(path, "the dataset_info.json of an earlier export")
        before = info.get("splits", {}).get(export.split, made_of)
        if info.get("name") != workpiece.name or before | {"command": ""} != made_of | {"command": ""}:
            raise InputError(path, "", f"another dataset, of {info.get('name')}", "a new folder, or the same options")
    elif export.folder.is_dir() and any(export.folder.iterdir()):
        raise InputError(export.folder, "", "not empty", "a new folder, or one that an export began")
    bin, view = heap_bin(workpiece), overhead_view(workpiece)
    write_models(workpiece, export.folder / "models")
    camera = vars(view.intrinsics) | {"depth_scale": depth_scale(workpiece)}
    write_json(export.folder / "camera.json", camera)
    info["bin"] = {"inner": [MM * x for x in bin.inner], **pose_entry(bin.T_world_bin, "R_bin2w", "t_bin2w")}
    info["splits"][export.split] = made_of
    write_json(path, info)
    text = (
        f"# {workpiece.name}\n\nDepth images of simulated bins, written by pickproof; no colour. Object {OBJECT} is "
        f"`{workpiece.name}`.\nWhat is visible was decided by ray casting, not by a tolerance of depth, and the pixels "
        "of an instance that were\nnot measured count as visible. `dataset_info.json` holds the commands and the bin "
        "in world coordinates, in mm.\n"
    )
    (export.folder / "dataset_info.md").write_text(text, encoding="utf-8")


@lru_cache(maxsize=1)
def _workpiece(name: str) -> Workpiece:
    return load_workpiece(name)


def _write_scene(export: Export, scene: int, poses: Array) -> None:
    """All files of one scene; scene_gt_info.json comes last and marks it complete."""
    workpiece = _workpiece(export.workpiece)
    folder = scene_folder(export.folder / export.split, scene)
    for name in ("depth", "mask", "mask_visib"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    cameras, truth, infos = {}, {}, {}
    scale = depth_scale(workpiece)
    for image in range(export.views):
        rng = np.random.default_rng((export.first_seed + scene, image))
        view = tilted_view(workpiece, rng, export.sensor) if image else overhead_view(workpiece, export.sensor)
        exact = render_heap(workpiece, poses, view)
        frame = measure(exact, view.intrinsics, view.T_world_camera, view.sensor, rng, workpiece.optics)
        counts = np.rint(frame.depth * (MM / scale)).astype(np.uint16)
        (folder / "depth" / f"{image:06d}.png").write_bytes(png(counts))
        Ts_camera_part = invert(view.T_world_camera) @ poses
        cameras[str(image)] = _camera(view, scale)
        truth[str(image)] = [{**pose_entry(T, "cam_R_m2c", "cam_t_m2c"), "obj_id": OBJECT} for T in Ts_camera_part]
        infos[str(image)] = [
            _instance(folder, mask_name(image, i), workpiece, T, exact.ids == i, counts > 0, view.intrinsics)
            for i, T in enumerate(Ts_camera_part)
        ]
    write_json(folder / CAMERA, cameras)
    write_json(folder / GROUND_TRUTH, truth)
    write_json(folder / GROUND_TRUTH_INFO, infos)


def _camera(view: View, scale: float) -> dict[str, Any]:
    to_camera = pose_entry(invert(view.T_world_camera), "cam_R_w2c", "cam_t_w2c")
    return {"cam_K": camera_entry(view.intrinsics), "depth_scale": scale, **to_camera}


def _instance(
    folder: Path, name: str, workpiece: Workpiece, T: Array, visible: np.ndarray, valid: np.ndarray, K: Intrinsics
) -> dict[str, Any]:
    """Write both masks of an instance; returns its entry of scene_gt_info.json.

    Args:
        visible: (h, w) bool, where its surface is the first that a ray meets.
        valid: (h, w) bool, where depth was measured.
    """
    u, v = silhouette(workpiece, T, K)
    inside = (u >= 0) & (u < K.width) & (v >= 0) & (v < K.height)
    mask = visible.copy()  # rays that graze its edge may differ by rounding
    mask[v[inside], u[inside]] = True
    (folder / "mask" / name).write_bytes(png(255 * mask.astype(np.uint8)))
    (folder / "mask_visib" / name).write_bytes(png(255 * visible.astype(np.uint8)))
    whole, seen = int(mask.sum() + (~inside).sum()), int(visible.sum())
    vs, us = np.nonzero(visible)
    return {
        "bbox_obj": _box(u, v) if seen else [-1] * 4,
        "bbox_visib": _box(us, vs) if seen else [-1] * 4,
        "px_count_all": whole,
        "px_count_valid": int((mask & valid).sum()),
        "px_count_visib": seen,
        "visib_fract": seen / whole if whole else 0.0,
    }


def silhouette(workpiece: Workpiece, T_camera_part: Array, K: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (u, v), each (n,) int, whose rays meet a workpiece alone, up to one width and height outside the image.

    The toolkit also counts the part of a silhouette that the image cuts off, on a canvas of that size.
    """
    R, t = T_camera_part[:3, :3], T_camera_part[:3, 3]
    corners = K.project(workpiece.vertices @ R.T + t)
    low = np.maximum(np.floor(corners.min(0)).astype(int), (-K.width, -K.height))
    high = np.minimum(np.ceil(corners.max(0)).astype(int), (2 * K.width - 1, 2 * K.height - 1))
    u, v = (x.ravel() for x in np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True))))
    rays = np.stack([(u - K.cx) / K.fx, (v - K.cy) / K.fy, np.ones(len(u))], axis=1)
    hit = workpiece.caster.cast(-R.T @ t, rays @ R).face >= 0
    return u[hit], v[hit]


def _box(u: np.ndarray, v: np.ndarray) -> list[int]:
    """x, y, width, height as the toolkit's calc_2d_bbox: the differences of the outermost pixels."""
    return [int(u.min()), int(v.min()), int(np.ptp(u)), int(np.ptp(v))]


def _write_targets(export: Export, scenes: int) -> None:
    """test_targets_bop19.json: how many instances there are to find in each image."""
    targets = []
    for scene in range(scenes):
        path = scene_folder(export.folder / export.split, scene) / GROUND_TRUTH_INFO
        for image, infos in read_json(path, "what an export writes").items():
            found = sum(info["visib_fract"] >= TARGET_VISIBILITY for info in infos)
            if found:
                targets.append({"im_id": int(image), "inst_count": found, "obj_id": OBJECT, "scene_id": scene})
    write_json(export.folder / "test_targets_bop19.json", targets)
