"""A replay without a browser: the recorded motion drawn by PyBullet's software renderer, as GIF, MP4 or PNG."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from pickproof.cell.errors import InputError
from pickproof.cell.frames import apply
from pickproof.cell.geometry.bin import Bin
from pickproof.cell.physics.arm import Arm
from pickproof.cell.physics.floating_gripper import floating_arm
from pickproof.cell.physics.picture import cell_picture
from pickproof.cell.physics.world import World
from pickproof.scenarios.files.atomic import StoreError
from pickproof.scenarios.replay.data import Replayed

KINDS = (".gif", ".mp4", ".png")
RATE = 12.5  # [1/s] pictures of a second of the motion
SIZE = (560, 420)
MOMENTS = 6
"""Pictures side by side of a PNG."""
WHOLE = 0.97  # [m] over both bins of the smallest cells, which are seen from nearest
HALVES = np.array([[x, y, 0.0] for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
INK, GOOD, BAD = (40, 36, 27), (60, 130, 30), (50, 60, 190)  # BGR


def record(shown: Replayed, path: Path) -> Path:
    """Write the motion of an attempt; the suffix of `path`, one of KINDS, decides the file format.

    Raises:
        InputError: another suffix. StoreError: the file cannot be written.
    """
    if path.suffix not in KINDS:
        raise InputError("command line", "--record", str(path), f"a file that ends in {', '.join(KINDS)}")
    frames = [draw for _, draw in pictures(shown, _chosen(shown, path.suffix))]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write(frames, path)
    except OSError as error:
        raise StoreError(f"{path}: cannot be written ({error.strerror or error})") from None
    return path


def pictures(shown: Replayed, frames: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """(time in [s], image (h, w, 3) uint8 BGR) at these frames of the motion."""
    world = World()
    try:
        for box in shown.boxes:
            world.add_box(box)
        if shown.artefact.carrier == "arm":
            arm = Arm(world, shown.robot.urdf, shown.robot.joints, shown.gripper)
        else:
            arm = floating_arm(world, shown.gripper)
        motion = shown.artefact.motion
        for T in motion.parts_at(0):
            world.add_part(shown.workpiece, T)
        (source, place), drawn = shown.bins, []
        eye, target = looking(source, place)
        for frame in frames:
            arm.reset(motion.q[frame], float(motion.opening[frame]))
            for i, T in enumerate(motion.parts_at(frame)):
                world.place_part(i, T)
            image = cell_picture(world, eye, target, *SIZE)[:, :, ::-1]
            drawn.append((float(motion.time[frame]), _captioned(image, shown, float(motion.time[frame]))))
    finally:
        world.close()
    return drawn


def looking(source: Bin, place: Bin) -> tuple[list[float], list[float]]:
    """Eye and target [m] from which both bins are in the picture, whatever their size."""
    corners = np.concatenate([apply(b.T_world_bin, HALVES * b.inner) for b in (source, place)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle = (np.array(source.position) + place.position) / 2
    scale = max(float(np.linalg.norm(high[:2] - low[:2])) / WHOLE, 1.0)
    eye, target = np.array([0.6, -0.75, 0.65]), np.array([-0.04, 0.02, 0.12])
    return (middle + scale * eye).tolist(), (middle + scale * target).tolist()


def _chosen(shown: Replayed, suffix: str) -> np.ndarray:
    motion = shown.artefact.motion
    times = motion.time
    if suffix != ".png":
        wanted = np.arange(0.0, float(times[-1]) + 0.5 / RATE, 1 / RATE)
        return np.unique(np.clip(np.searchsorted(times, wanted), 0, len(times) - 1))
    return np.unique(np.linspace(0, len(times) - 1, MOMENTS).astype(int))


def _captioned(image: np.ndarray, shown: Replayed, at: float) -> np.ndarray:
    image = np.ascontiguousarray(image)
    r, font = shown.record, cv2.FONT_HERSHEY_SIMPLEX
    text = f"seed {r.seed}, attempt {r.attempt}: {r.grasp or 'no pick'}, {at:.2f} s"
    cv2.putText(image, text, (10, SIZE[1] - 12), font, 0.5, INK, 1, cv2.LINE_AA)
    cv2.putText(image, shown.outcome, (10, 22), font, 0.6, GOOD if r.success else BAD, 2, cv2.LINE_AA)
    return image


def _write(frames: list[np.ndarray], path: Path) -> None:
    if path.suffix == ".gif":
        images = [Image.fromarray(f[:, :, ::-1]).quantize(96, dither=Image.Dither.NONE) for f in frames]
        images[0].save(path, save_all=True, append_images=images[1:], duration=round(1000 / RATE), loop=0)
    elif path.suffix == ".mp4":
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), RATE, SIZE)
        if not writer.isOpened():
            raise OSError("no encoder for MP4, or the folder is not writable")
        for frame in frames:
            writer.write(frame)
        writer.release()
    else:
        columns = min(3, len(frames))
        blank = [np.full_like(frames[0], 255)] * (-len(frames) % columns)
        rows = [np.hstack([*frames, *blank][i : i + columns]) for i in range(0, len(frames), columns)]
        if not cv2.imwrite(str(path), np.vstack(rows)):
            raise OSError("the folder is not writable")
