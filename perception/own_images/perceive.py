"""The poses of workpieces in a depth image or point cloud of the user's own."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pickproof.cell.config import Config, Size, load
from pickproof.cell.errors import InputError
from pickproof.cell.frames import apply, invert
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import Workpiece, load_workpiece
from pickproof.perception.camera_files.check import FARTHEST, check_pose
from pickproof.perception.data.region import region_of_interest
from pickproof.perception.estimate import Perception, method_for
from pickproof.perception.method import Method
from pickproof.perception.own_images.pose_picture import draw_poses
from pickproof.perception.own_images.user_frame import Options, read_frame
from pickproof.perception.ps6d.cloud import roi_mask, scene_cloud
from pickproof.perception.ps6d.point_hierarchy import VOXELS
from pickproof.perception.ps6d.weights import file_hash, weights_path
from pickproof.perception.refinement.refine import RefineResult

SCHEMA = 1
MOST_VOXELS = 150_000
"""Occupied voxels of level 0 up to which a cloud is taken: some seconds and 2 GB."""
LARGER = 4.0
"""How many times as wide and as long as what is seen a bin can be."""


class BinFile(Config):
    """A bin in the frame of the input: inner length, width and depth [m], and the pose of its floor's centre, z up."""

    inner: Size
    T_world_bin: tuple[tuple[float, float, float, float], ...]


@dataclass(frozen=True)
class PerceptionRequest:
    """What is perceived.

    Attributes:
        workpiece: its name; input: the file of a depth image or of a cloud; options: what is said of it.
        box: low, then high corner of a box that holds the workpieces, in [m] in world coordinates; bin: file of a bin
            in its place.
        weights: None for the shipped ones; seed: of the voting points and seeds; method: how poses are found.
        out: folder of poses.json and poses.png; None for the usual one.
        command: the command line, for the record.
    """

    workpiece: str
    input: Path
    options: Options
    box: list[float] | None = None
    bin: Path | None = None
    weights: Path | None = None
    seed: int = 0
    out: Path | None = None
    command: str = ""
    method: Method = "auto"


@dataclass(frozen=True)
class Perceived:
    """What was perceived: poses.json, its folder, and the pixels that were looked at."""

    document: dict[str, Any]
    out: Path
    frame: DepthFrame
    pixels: int


def perceive(asked: PerceptionRequest, warn: Callable[[str], None]) -> Perceived:
    """Find the poses and write poses.json and poses.png; `warn` is told what looks wrong in the input.

    Raises:
        InputError: input or weights cannot be used.
    """
    workpiece = load_workpiece(asked.workpiece)
    frame = read_frame(asked.input, asked.options, workpiece, warn)
    region = region_of(frame, workpiece, asked.box, asked.bin)
    _check_region(asked.input, frame, region, workpiece)
    perception = Perception.load(workpiece, asked.weights, method=asked.method)
    clock = time.perf_counter()
    result = perception.perceive_region(frame, region, np.random.default_rng(asked.seed))
    seconds = time.perf_counter() - clock
    out = asked.out or Path("out") / "perceive" / workpiece.name
    out.mkdir(parents=True, exist_ok=True)
    document = {
        "schema": SCHEMA,
        "workpiece": workpiece.name,
        "input": str(asked.input),
        "command": asked.command,
        "method": method_for(workpiece, asked.method, asked.weights),
        "weights": None if perception.network is None else file_hash(asked.weights or weights_path(workpiece)),
        "camera": vars(frame.intrinsics) | {"sigma_m": frame.sigma, "T_world_camera": frame.T_world_camera.tolist()},
        "seconds": seconds,
        "poses": poses_of(result, frame),
    }
    (out / "poses.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    draw_poses(frame, region, workpiece, result.estimates, out / "poses.png")
    return Perceived(document, out, frame, int(region.sum()))


def poses_of(result: RefineResult, frame: DepthFrame) -> list[dict[str, Any]]:
    """Estimates as they stand in poses.json, best score first; lengths in [m]."""
    return [
        {
            "T_camera_workpiece": e.T_camera_part.tolist(),
            "T_world_workpiece": (frame.T_world_camera @ e.T_camera_part).tolist(),
            "score": e.score,
            "visible_share": e.visible_share,
            "residual_m": e.residual,
            "votes": e.n_votes,
        }
        for e in result.estimates
    ]


def region_of(
    frame: DepthFrame, workpiece: Workpiece, box: list[float] | None = None, bin: Path | None = None
) -> np.ndarray:
    """(h, w) bool: pixels in a box (low, then high corner) or a bin in world coordinates, or off all that is flat."""
    if box is not None:
        low, high = np.reshape(box, (2, 3))
        if not (np.isfinite(box).all() and (low < high).all()):
            raise InputError("command line", "--roi", box, "a low corner, then a high corner")
        if np.abs(box).max() > FARTHEST:
            raise InputError("command line", "--roi", box, f"within {FARTHEST:g} m; in m, is it in mm?")
        points, pixels = frame.points_camera()
        world = apply(frame.T_world_camera, points)
        inside = pixels[((world > low) & (world < high)).all(1)]
        mask = np.zeros(frame.depth.shape, dtype=bool)
        mask[inside[:, 0], inside[:, 1]] = True
        return mask
    if bin is not None:
        described = load(BinFile, bin)
        T_world_bin = np.array(described.T_world_bin, dtype=np.float64)
        check_pose(T_world_bin, bin, "T_world_bin")
        # a bin's floor is level in its world, so the world is put into the bin's frame
        in_bin = replace(frame, T_world_camera=invert(T_world_bin) @ frame.T_world_camera)
        _check_bin(bin, in_bin, described.inner)
        return roi_mask(in_bin, Bin("bin", described.inner, 0.0, (0.0, 0.0, 0.0)))
    return region_of_interest(frame, workpiece)


def _check_bin(path: Path, in_bin: DepthFrame, inner: tuple[float, float, float]) -> None:
    """The camera, whose pose is now that in the bin, looks into it from above, and sees more than a corner of it."""
    height = float(in_bin.T_world_camera[2, 3])
    if height <= 0:
        valid = "a bin whose z axis leaves its floor towards the camera"
        raise InputError(path, "T_world_bin", f"the camera {-height:.3g} m below the floor", valid)
    seen = np.ptp(np.percentile(in_bin.points_world()[:, :2], (1, 99), axis=0), axis=0)
    if (np.array(inner[:2]) > LARGER * seen).all():
        found = f"{inner[0]:g} x {inner[1]:g} m, where the input shows {seen[0]:.3g} x {seen[1]:.3g} m"
        raise InputError(path, "inner", found, f"at most {LARGER:g} times what is seen; in m")


def _check_region(path: Path, frame: DepthFrame, region: np.ndarray, workpiece: Workpiece) -> None:
    """It holds something, and not too much."""
    if region.sum() < 64:
        valid = "64 or more; --roi or --bin says where workpieces lie"
        raise InputError(path, "region of interest", f"{int(region.sum())} measured pixels", valid)
    cells = np.floor(scene_cloud(frame, region, workpiece.unit).points / VOXELS[0]).astype(np.int64)
    occupied = len(np.unique(cells @ np.array([1, 1 << 20, 1 << 40])))
    if occupied > MOST_VOXELS:
        size = f"{occupied} cells of {1e3 * VOXELS[0] * workpiece.unit:.2g} mm"
        raise InputError(path, "region of interest", size, f"{MOST_VOXELS} at most; limit it with --roi or --bin")
