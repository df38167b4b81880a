"""Names, units and numbers of the BOP scene-wise format, as bop_toolkit's docs/bop_datasets_format.md defines it.

Lengths in its files are millimetres, matrices are stored row by row, the camera's axes and the centre of the first
pixel are ours. In memory everything is in [m].
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.frames import Array, make_transform
from pickproof.cell.sensing.camera import Intrinsics

MM = 1000.0
CAMERA, GROUND_TRUTH, GROUND_TRUTH_INFO = "scene_camera.json", "scene_gt.json", "scene_gt_info.json"
DATASET_INFO, MODELS_INFO = "dataset_info.json", "models_info.json"


def pose_entry(T: Array, R_name: str, t_name: str) -> dict[str, list[float]]:
    """A transform (4, 4) in [m] as two fields: R row by row, t in [mm]."""
    return {R_name: T[:3, :3].ravel().tolist(), t_name: (MM * T[:3, 3]).tolist()}


def read_pose(entry: dict[str, Any], R_name: str, t_name: str) -> Array:
    """The transform (4, 4) in [m] of what `pose_entry` gives."""
    return make_transform(np.reshape(entry[R_name], (3, 3)), np.reshape(entry[t_name], 3) / MM)


def camera_entry(K: Intrinsics) -> list[float]:
    """cam_K, row by row."""
    return [K.fx, 0.0, K.cx, 0.0, K.fy, K.cy, 0.0, 0.0, 1.0]


def scene_folder(split: Path, scene: int) -> Path:
    """Folder of a scene."""
    return split / f"{scene:06d}"


def of_sensor(name: str, sensor: str) -> str:
    """Name of a file or folder of a sensor, as BOP-Industrial has them: scene_gt_photoneo.json, depth_photoneo."""
    path = Path(name)
    return f"{path.stem}_{sensor}{path.suffix}" if sensor else name


def mask_name(image: int, instance: int) -> str:
    """File name of an instance's mask; `instance` is its index in scene_gt.json."""
    return f"{image:06d}_{instance:06d}.png"


def read_json(path: Path, valid: str) -> Any:
    """A JSON file.

    Raises:
        InputError: missing or not JSON; `valid` says what it ought to be.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(path, "", "missing file", valid) from None
    except (OSError, ValueError) as error:
        raise InputError(path, "", str(error), valid) from None


def write_json(path: Path, document: dict[str, Any] | list[Any]) -> None:
    """Entries one a line, as the toolkit writes them; whole or not at all."""
    if isinstance(document, list):
        lines = [json.dumps(entry) for entry in document]
    else:
        lines = [f"{json.dumps(key)}: {json.dumps(entry)}" for key, entry in document.items()]
    left, right = "[]" if isinstance(document, list) else "{}"
    part = path.with_name(path.name + ".part")
    part.write_text(f"{left}\n  " + ",\n  ".join(lines) + f"\n{right}\n", encoding="utf-8")
    part.replace(path)
