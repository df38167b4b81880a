"""`pickproof perceive`: the poses of workpieces in a depth image or point cloud of the user's own."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pickproof.cell.config import Config, Size, load
from pickproof.cell.errors import InputError
from pickproof.cell.frames import apply, invert
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.sensing.camera import DepthFrame
from pickproof.cell.workpiece.workpiece import UNITS, Workpiece, load_workpiece
from pickproof.perception.camera_files.check import FARTHEST, check_pose, check_sigma, check_step
from pickproof.perception.data.bop_format import MM
from pickproof.perception.data.region import region_of_interest
from pickproof.perception.estimate import Perception
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `pickproof perceive`."""
    parser.add_argument("workpiece")
    parser.add_argument("input", type=Path, help="depth: PNG, TIFF, NPY, NPZ; cloud: PLY, PCD, XYZ, PTS, NPY, NPZ")
    parser.add_argument("--camera", type=Path, metavar="FILE", help="intrinsics of a depth image, as JSON or YAML")
    for name in ("fx", "fy", "cx", "cy"):
        parser.add_argument(f"--{name}", type=float, metavar="PIXEL", help="all four in place of --camera")
    parser.add_argument("--depth-scale", type=float, metavar="MM", help="millimetres a count of a depth image")
    parser.add_argument("--camera-id", type=int, metavar="ID", help="entry of a scene_camera.json (default: by name)")
    parser.add_argument("--depth-is", choices=("z", "range"), default="z", help="range: the length of the ray")
    parser.add_argument("--unit", choices=sorted(UNITS), help="of a cloud or of depth in floats (default m)")
    parser.add_argument("--camera-pose", type=Path, metavar="FILE", help="4 x 4 T_world_camera of the input, in m")
    parser.add_argument("--sigma", type=float, metavar="M", help="noise of a depth (default: measured in the input)")
    where = parser.add_mutually_exclusive_group()
    box = ("X0", "Y0", "Z0", "X1", "Y1", "Z1")
    where.add_argument("--roi", type=float, nargs=6, metavar=box, help="box that holds the workpieces, in m")
    where.add_argument("--bin", type=Path, metavar="FILE", help="YAML with inner and T_world_bin, in m")
    parser.add_argument("--weights", type=Path, default=None, help="weights (default the shipped ones)")
    parser.add_argument("--seed", type=int, default=0, help="of the voting points")
    parser.add_argument("--json", action="store_true", help="print the poses as JSON")
    parser.add_argument("--out", type=Path, default=None, help="output folder (default out/perceive/WORKPIECE)")


def main(args: argparse.Namespace) -> int:
    """`pickproof perceive WORKPIECE INPUT`."""
    workpiece = load_workpiece(args.workpiece)
    frame = read_frame(args.input, _options(args), workpiece, _warn)
    region = region_of(frame, workpiece, args.roi, args.bin)
    _check_region(args.input, frame, region, workpiece)
    perception = Perception.load(workpiece, args.weights)
    clock = time.perf_counter()
    result = perception.perceive_region(frame, region, np.random.default_rng(args.seed))
    seconds = time.perf_counter() - clock
    out = args.out or Path("out") / "perceive" / workpiece.name
    out.mkdir(parents=True, exist_ok=True)
    document = {
        "schema": SCHEMA,
        "workpiece": workpiece.name,
        "input": str(args.input),
        "command": f"pickproof {shlex.join(args.words)}",
        "weights": file_hash(args.weights or weights_path(workpiece)),
        "camera": vars(frame.intrinsics) | {"sigma_m": frame.sigma, "T_world_camera": frame.T_world_camera.tolist()},
        "seconds": seconds,
        "poses": poses_of(result, frame),
    }
    (out / "poses.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    draw_poses(frame, region, workpiece, result.estimates, out / "poses.png")
    if args.json:
        print(json.dumps(document, indent=1))
        return 0
    K = frame.intrinsics
    print(f"{K.width} x {K.height} pixels, {int(region.sum())} of them of interest, noise {1e3 * frame.sigma:.2f} mm")
    print(f"{len(result.estimates)} {workpiece.name} found in {seconds:.2f} s")
    print(f"wrote {out / 'poses.json'} and {out / 'poses.png'}")
    return 0


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


def _warn(text: str) -> None:
    print(f"pickproof: warning: {text}", file=sys.stderr)


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


def _options(args: argparse.Namespace) -> Options:
    given = {name: getattr(args, name) for name in ("fx", "fy", "cx", "cy")}
    said = {name: value for name, value in given.items() if value is not None}
    if said and (len(said) < 4 or args.camera is not None):
        missing = ", ".join(f"--{name}" for name in given if name not in said)
        value = f"--camera and {', '.join(f'--{n}' for n in said)}" if args.camera else f"no {missing}"
        raise InputError("command line", "intrinsics", value, "--camera FILE, or all of --fx --fy --cx --cy")
    if args.depth_scale is not None:
        check_step(args.depth_scale / MM, "command line", "--depth-scale")
    if args.sigma is not None:
        check_sigma(args.sigma, "command line", "--sigma")
    if args.seed < 0:
        raise InputError("command line", "--seed", args.seed, "0 or more")
    return Options(
        camera=args.camera,
        focal=(args.fx, args.fy) if said else None,
        centre=(args.cx, args.cy) if said else None,
        camera_id=args.camera_id,
        depth_scale=args.depth_scale,
        unit=args.unit,
        depth_is=args.depth_is,
        pose=args.camera_pose,
        sigma=args.sigma,
    )
