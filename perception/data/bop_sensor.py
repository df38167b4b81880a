"""Splits and sensors of a BOP dataset; those of BOP-Industrial hold several sensors in one scene."""

from __future__ import annotations

from pathlib import Path

from pickproof.cell.errors import InputError
from pickproof.perception.data.bop_format import GROUND_TRUTH, GROUND_TRUTH_INFO, of_sensor


def split_folder(folder: Path, split: str | None) -> Path:
    """The folder of a split; None for the only one that has true poses.

    Raises:
        InputError: no such split, or several and none was named.
    """
    names = sorted({p.parent.parent.name for p in folder.glob("*/*/scene_gt*.json") if _sensor(p) is not None})
    if split is None and len(names) == 1:
        split = names[0]
    if split not in names:
        raise InputError("command line", "--split", split, f"one of: {', '.join(names) or f'no split in {folder}'}")
    return folder / split


def sensor_of(split: Path, sensor: str | None) -> str:
    """The sensor whose depth and true poses a split holds; empty where names carry none.

    Raises:
        InputError: no such sensor, or several and none was named.
    """
    names = sorted({name for p in split.glob("*/scene_gt*.json") if (name := _sensor(p)) is not None})
    with_depth = [name for name in names if any(split.glob(f"*/{of_sensor('depth', name)}"))] or names
    if sensor is None and len(with_depth) == 1:
        return with_depth[0]
    if sensor is None and "" in with_depth:
        return ""
    if sensor not in with_depth:
        known = ", ".join(name for name in with_depth if name) or f"none: {split} has but one"
        raise InputError("command line", "--bop-sensor", sensor, f"one of: {known}")
    return sensor


def _sensor(path: Path) -> str | None:
    """That a scene_gt.json is of; None for scene_gt_info.json, of whatever sensor."""
    info, truth = Path(GROUND_TRUTH_INFO).stem, Path(GROUND_TRUTH).stem
    if path.stem == info or path.stem.startswith(f"{info}_"):
        return None
    return path.stem.removeprefix(truth).removeprefix("_")
