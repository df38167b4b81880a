"""What bop_toolkit's docs/bop_datasets_format.md asks of a dataset in the scene-wise format, and of BOP's result files.

Written from that text and from the toolkit's scripts alone, without anything of the exporter's.
"""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh

GT_INFO = {"bbox_obj", "bbox_visib", "px_count_all", "px_count_valid", "px_count_visib", "visib_fract"}


def problems_of(dataset: Path, split: str) -> list[str]:
    """Everything that is not as the format has it; empty for a sound dataset."""
    found: list[str] = []

    def expect(holds: bool, what: str) -> None:
        if not holds:
            found.append(what)

    camera = json.loads((dataset / "camera.json").read_text())
    expect({"cx", "cy", "depth_scale", "fx", "fy", "height", "width"} <= set(camera), "camera.json")
    meshes = check_models(dataset / "models", expect)
    scenes = sorted(p for p in (dataset / split).iterdir() if p.is_dir())
    expect(bool(scenes), "no scene")
    for scene in scenes:
        expect(re.fullmatch(r"\d{6}", scene.name) is not None, f"name of scene {scene.name}")
        cameras, truths, infos = (
            json.loads((scene / f"scene_{name}.json").read_text()) for name in ("camera", "gt", "gt_info")
        )
        expect(set(cameras) == set(truths) == set(infos), f"{scene.name}: images differ between the files")
        expect({p.stem for p in (scene / "depth").iterdir()} == {f"{int(k):06d}" for k in cameras}, "depth images")
        for key in cameras:
            at = f"{scene.name}/{key}"
            depth = cv2.imread(str(scene / "depth" / f"{int(key):06d}.png"), cv2.IMREAD_UNCHANGED)
            expect(depth.dtype == np.uint16 and depth.ndim == 2, f"{at}: depth is no 16-bit image")
            expect(depth.shape == (camera["height"], camera["width"]), f"{at}: size")
            expect(len(truths[key]) == len(infos[key]), f"{at}: instances")
            K = np.reshape(cameras[key]["cam_K"], (3, 3))
            expect(K[2].tolist() == [0, 0, 1] and K[1, 0] == 0, f"{at}: cam_K")
            check_rotation(np.reshape(cameras[key]["cam_R_w2c"], (3, 3)), f"{at}: cam_R_w2c", expect)
            expect(len(cameras[key]["cam_t_w2c"]) == 3 and cameras[key]["depth_scale"] > 0, f"{at}: camera")
            depth_mm = depth * cameras[key]["depth_scale"]
            for i, (truth, info) in enumerate(zip(truths[key], infos[key], strict=True)):
                check_instance(scene, int(key), i, truth, info, K, depth_mm, meshes[truth["obj_id"]], expect)
    return found


def check_models(folder: Path, expect: Any) -> dict[int, trimesh.Trimesh]:
    infos = json.loads((folder / "models_info.json").read_text())
    meshes = {}
    for key, info in infos.items():
        path = folder / f"obj_{int(key):06d}.ply"
        head = path.read_bytes()[:400].decode("ascii")
        expect("format ascii 1.0" in head and "property float nx" in head, f"{path.name}: ASCII with normals")
        mesh = trimesh.load(path, force="mesh", process=False)
        low, size = mesh.vertices.min(0), np.ptp(mesh.vertices, axis=0)
        expect(np.allclose([info[f"min_{a}"] for a in "xyz"], low, atol=1e-3), f"{key}: min")
        expect(np.allclose([info[f"size_{a}"] for a in "xyz"], size, atol=1e-3), f"{key}: size")
        expect(np.abs(low + size / 2).max() < 1e-3 * size.max(), f"{key}: origin at the centre of the box")
        few = mesh.convex_hull.vertices  # two vertices farthest apart are on it
        largest = max(float(np.linalg.norm(few - v, axis=1).max()) for v in few)
        expect(abs(info["diameter"] - largest) < 1e-3, f"{key}: diameter")
        for T in info.get("symmetries_discrete", []):
            T = np.reshape(T, (4, 4))
            check_rotation(T[:3, :3], f"{key}: symmetry", expect)
            expect(T[3].tolist() == [0, 0, 0, 1] and not np.allclose(T, np.eye(4)), f"{key}: symmetry")
        for turn in info.get("symmetries_continuous", []):
            expect(abs(np.linalg.norm(turn["axis"]) - 1) < 1e-9 and len(turn["offset"]) == 3, f"{key}: axis")
        meshes[int(key)] = mesh
    return meshes


def check_rotation(R: np.ndarray, what: str, expect: Any) -> None:
    expect(np.allclose(R @ R.T, np.eye(3), atol=1e-6) and np.linalg.det(R) > 0, what)


def check_instance(
    scene: Path, image: int, i: int, truth: Any, info: Any, K: np.ndarray, depth_mm: np.ndarray, mesh: Any, expect: Any
) -> None:
    at = f"{scene.name}/{image}/{i}"
    R, t = np.reshape(truth["cam_R_m2c"], (3, 3)), np.array(truth["cam_t_m2c"])
    check_rotation(R, f"{at}: cam_R_m2c", expect)
    expect(set(info) == GT_INFO, f"{at}: fields of scene_gt_info")
    masks = {}
    for kind in ("mask", "mask_visib"):
        mask = cv2.imread(str(scene / kind / f"{image:06d}_{i:06d}.png"), cv2.IMREAD_UNCHANGED)
        expect(mask is not None and mask.shape == depth_mm.shape and set(np.unique(mask)) <= {0, 255}, f"{at}: {kind}")
        masks[kind] = mask > 0
    whole, seen = masks["mask"], masks["mask_visib"]
    expect(not (seen & ~whole).any(), f"{at}: visible outside the silhouette")
    expect(info["px_count_visib"] == seen.sum(), f"{at}: px_count_visib")
    expect(info["px_count_all"] >= whole.sum(), f"{at}: px_count_all")
    expect(info["px_count_valid"] == (whole & (depth_mm > 0)).sum(), f"{at}: px_count_valid")
    if info["px_count_all"]:
        expect(abs(info["visib_fract"] - info["px_count_visib"] / info["px_count_all"]) < 1e-9, f"{at}: visib_fract")
    if not seen.any():
        expect(info["bbox_visib"] == info["bbox_obj"] == [-1] * 4, f"{at}: box of what is hidden")
        return
    expect(info["bbox_visib"] == box_of(seen), f"{at}: bbox_visib")
    points = mesh.vertices @ R.T + t  # in mm
    uv = points[:, :2] / points[:, 2:] * [K[0, 0], K[1, 1]] + [K[0, 2], K[1, 2]]
    x, y, w, h = info["bbox_obj"]
    off = np.abs(np.concatenate([uv.min(0) - (x, y), uv.max(0) - (x + w, y + h)])).max()
    expect(off < 1.5, f"{at}: bbox_obj is {off:.1f} pixels off the projected model")
    if info["px_count_all"] == whole.sum():
        expect(info["bbox_obj"] == box_of(whole), f"{at}: bbox_obj")
    measured = depth_mm[seen & (depth_mm > 0)]
    if len(measured):
        near, far = points[:, 2].min(), points[:, 2].max()
        expect(near - 3 < np.median(measured) < far + 3, f"{at}: depth is not that of the model")


def box_of(mask: np.ndarray) -> list[int]:
    """As calc_2d_bbox of the toolkit."""
    v, u = np.nonzero(mask)
    return [int(u.min()), int(v.min()), int(u.max() - u.min()), int(v.max() - v.min())]


def read_results(path: Path) -> list[dict[str, Any]]:
    """BOP's result file, read as the toolkit's load_bop_results reads it; the time is one for each image."""
    with path.open(newline="") as file:
        assert file.readline().strip() == "scene_id,im_id,obj_id,score,R,t,time"
        rows = list(csv.reader(file))
    results = [
        {
            "image": (int(row[0]), int(row[1])),
            "obj": int(row[2]),
            "score": float(row[3]),
            "R": np.array(row[4].split(), dtype=float).reshape(3, 3),
            "t": np.array(row[5].split(), dtype=float).reshape(3),
            "time": float(row[6]),
        }
        for row in rows
    ]
    assert len({(r["image"], r["time"]) for r in results}) == len({r["image"] for r in results})
    return results
