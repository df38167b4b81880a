"""The replay file of one attempt: compressed arrays, DIR/replay/SEED-ATTEMPT.npz.

Depth in steps of 0.1 mm as PNG, positions in steps of 10 um, and of every grasp pose its verdict in one byte: some
200 kB for 30 workpieces and 640 x 480 pixels.
"""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, from_quat_xyzw, to_quat_xyzw
from pickproof.cell.sensing.camera import Intrinsics
from pickproof.scenarios.files.atomic import write_whole

FOLDER = "replay"
VERSION = 1
DEPTH_STEP = 1e-4  # [m]
LENGTH_STEP = 1e-5  # [m]
QUAT_STEP = 1 / 32767
SHOWN = 8  # attempts that are named where another one was asked for


@dataclass(frozen=True)
class Motion:
    """The motion of an attempt from start to end, every 20 ms.

    Attributes:
        time: (f,) in [s] from the start.
        q: (f, dof) joints of the carrier, in [rad], or [m] for the slides of a floating gripper; opening: (f,) of the
        jaws [m].
        poses: (f, n, 7) of all workpieces: position [m] and quaternion in the order x, y, z, w.
    """

    time: Array
    q: Array
    opening: Array
    poses: Array

    def parts_at(self, frame: int) -> Array:
        """Ts_world_part (n, 4, 4) at a frame."""
        return poses_to_matrices(self.poses[frame])


@dataclass(frozen=True)
class Artefact:
    """The replay data of one attempt.

    Attributes:
        seed, attempt: identify it; carrier: `arm`, or `gantry` (stored name) for the floating gripper of the motion
            oracle.
        depth: (h, w) measured in [m], 0 where missing; intrinsics, T_world_camera (4, 4): the calibration used by the
            cell.
        Ts_world_estimate: (k, 4, 4), best first; scores (k,); residuals (k,) in [m].
        Ts_part_tool: (p, 4, 4) grasp poses of the CAD; grasps: (p,) name of each; openings: (p,) in [m].
        verdicts: (k, p) why each pose of each estimate was ruled out; empty for those that became candidates.
        candidates: the ranked ones, best first: `estimate`, `grasp`, `T_world_tool`, `opening`, `rank`, `terms`,
            `verdict` and, where planning refused, `detail`.
        motion: with a single frame for a no-pick.
    """

    seed: int
    attempt: int
    carrier: str
    depth: np.ndarray
    intrinsics: Intrinsics
    T_world_camera: Array
    Ts_world_estimate: Array
    scores: Array
    residuals: Array
    Ts_part_tool: Array
    grasps: np.ndarray
    openings: Array
    verdicts: np.ndarray
    candidates: list[dict[str, Any]]
    motion: Motion


def path_of(directory: Path, seed: int, attempt: int) -> Path:
    """Where the artefact of an attempt lies in the folder of a campaign."""
    return directory / FOLDER / f"{seed}-{attempt}.npz"


def write_artefact(path: Path, a: Artefact) -> Path:
    """Write it whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    grasps, of_pose = np.unique(a.grasps.astype(str), return_inverse=True)
    reasons, verdicts = np.unique(a.verdicts.astype(str), return_inverse=True)
    i = a.intrinsics
    head = {
        "version": VERSION,
        "seed": a.seed,
        "attempt": a.attempt,
        "carrier": a.carrier,
        "intrinsics": [i.width, i.height, i.fx, i.fy, i.cx, i.cy],
        "grasps": grasps.tolist(),
        "reasons": reasons.tolist(),
        "candidates": [c | {"T_world_tool": _rounded(c["T_world_tool"])} for c in a.candidates],
    }
    depth = cv2.imencode(".png", np.rint(a.depth / DEPTH_STEP).astype(np.uint16), [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        head=np.frombuffer(json.dumps(head).encode(), np.uint8),
        depth=depth.ravel(),
        T_world_camera=a.T_world_camera,
        estimates=a.Ts_world_estimate.astype(np.float32),
        scores=a.scores.astype(np.float32),
        residuals=a.residuals.astype(np.float32),
        tools=a.Ts_part_tool.astype(np.float32),
        of_pose=of_pose.astype(np.uint16),
        openings=a.openings.astype(np.float32),
        verdicts=verdicts.reshape(a.verdicts.shape).astype(np.uint8),
        time=a.motion.time.astype(np.float32),
        q=a.motion.q.astype(np.float32),
        opening=a.motion.opening.astype(np.float32),
        poses=_squeezed(a.motion.poses),
    )
    return write_whole(path, buffer.getvalue())


def read_artefact(path: Path) -> Artefact:
    """Read what `write_artefact` wrote.

    Raises:
        InputError: the file is missing, damaged or of a newer version.
    """
    if not path.is_file():
        kept = sorted(tuple(map(int, p.stem.split("-"))) for p in path.parent.glob("[0-9]*-[0-9]*.npz"))
        here = ", ".join(f"{seed}-{attempt}" for seed, attempt in kept[:SHOWN]) + (", ..." if len(kept) > SHOWN else "")
        valid = f"an attempt that was kept (SEED-ATTEMPT: {here or 'none'}); `pickproof run --keep all` keeps every one"
        raise InputError(path, "", "missing file", valid)
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as data:
            head = json.loads(data["head"].tobytes())
            d = {name: data[name] for name in data.files}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise InputError(path, "", str(error), "a file that `pickproof run` wrote") from None
    if head["version"] > VERSION:
        raise InputError(path, "version", head["version"], f"at most {VERSION}; a newer pickproof wrote this file")
    depth = np.asarray(cv2.imdecode(d["depth"], cv2.IMREAD_UNCHANGED))
    width, height, *lens = head["intrinsics"]
    return Artefact(
        seed=head["seed"],
        attempt=head["attempt"],
        carrier=head["carrier"],
        depth=depth.astype(np.float32) * DEPTH_STEP,
        intrinsics=Intrinsics(int(width), int(height), *lens),
        T_world_camera=d["T_world_camera"],
        Ts_world_estimate=d["estimates"].astype(np.float64),
        scores=d["scores"],
        residuals=d["residuals"],
        Ts_part_tool=d["tools"].astype(np.float64),
        grasps=np.array(head["grasps"], dtype=str)[d["of_pose"]],
        openings=d["openings"].astype(np.float64),
        verdicts=np.array(head["reasons"], dtype=str)[d["verdicts"]],
        candidates=[c | {"T_world_tool": np.array(c["T_world_tool"])} for c in head["candidates"]],
        motion=Motion(d["time"], d["q"].astype(np.float64), d["opening"], _unsqueezed(d)),
    )


def poses_to_matrices(poses: Array) -> Array:
    """Ts (n, 4, 4) of poses (n, 7): position and quaternion in the order x, y, z, w."""
    return np.stack([from_quat_xyzw(p[:3], p[3:] / np.linalg.norm(p[3:])) for p in poses]).reshape(-1, 4, 4)


def matrices_to_poses(Ts: Array) -> Array:
    """Poses (n, 7) of Ts (n, 4, 4), the inverse of `poses_to_matrices`."""
    return np.concatenate([Ts[:, :3, 3], to_quat_xyzw(Ts).reshape(-1, 4)], axis=1)


def _squeezed(poses: Array) -> np.ndarray:
    """Whole steps, differenced along time with time last: what lies still becomes zeros."""
    steps = poses.copy()
    steps[..., :3] /= LENGTH_STEP
    steps[..., 3:] /= QUAT_STEP
    whole = np.rint(steps).astype(np.int32).transpose(1, 2, 0)
    return np.diff(whole, axis=2, prepend=0)


def _unsqueezed(data: dict[str, np.ndarray]) -> Array:
    poses = np.cumsum(data["poses"], axis=2).transpose(2, 0, 1).astype(np.float64)
    poses[..., :3] *= LENGTH_STEP
    poses[..., 3:] *= QUAT_STEP
    return poses


def _rounded(T: Array) -> list[list[float]]:
    return [[round(float(x), 6) for x in row] for row in T]
