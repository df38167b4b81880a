"""Faults planted in the files of which a system is made: a copy of the bracket or its gripper with one thing wrong."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import yaml
from safetensors import safe_open
from safetensors.numpy import save_file

from pickproof.cell.child_process import child_environment
from pickproof.cell.grippers.registry import gripper_path
from pickproof.cell.workpiece.workpiece import load_workpiece

FAULTS = ("point", "grasp", "weights", "friction")
POINT = "edge_of_plate"
"""The one of the fault `point`: every sixth pick is made with it."""
MOVED = 0.004
"""[m] that one grasp point, or each of them, is moved along its closing direction."""
NOISE = 0.9
"""Standard deviation of each weight's error in shares of the weight."""
PADS = 0.0003
"""Friction of the pads in place of 0.8: 40 N hold 48 g in the hand with less than a thirtieth of that."""


@contextmanager
def planted(fault: str, folder: Path) -> Iterator[list[str]]:
    """What of a bracket's scenario is to be set while this fault, or `none`, is at work; files are made in `folder`."""
    if fault == "none":
        yield []
    elif fault == "friction":
        yield [f"gripper={_worn_pads(folder)}"]
    else:
        copy = folder / "workpieces" / "bracket"
        if not copy.exists():
            shutil.copytree(load_workpiece("bracket").folder, copy)
            if fault == "weights":
                _noise_weights(copy)
            else:
                _move_grasps(copy, {POINT} if fault == "point" else None)
        with child_environment({"PICKPROOF_WORKPIECES": str(copy.parent.resolve())}):
            yield []


def _move_grasps(copy: Path, names: set[str] | None) -> None:
    path = copy / "grasps.yaml"
    table = yaml.safe_load(path.read_text(encoding="utf-8"))
    for grasp in table["grasps"]:
        if names is None or grasp["name"] in names:
            grasp["centre"] = [float(c + MOVED * n) for c, n in zip(grasp["centre"], grasp["closing"], strict=True)]
    path.write_text(yaml.safe_dump(table), encoding="utf-8")


def _noise_weights(copy: Path) -> None:
    path, rng = copy / "ps6d.safetensors", np.random.default_rng(0)
    with safe_open(path, framework="np") as file:
        meta, tensors = file.metadata(), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    for name, values in tensors.items():
        if values.ndim > 1:  # not the statistics of the normalisation
            tensors[name] = (values * rng.normal(1.0, NOISE, values.shape)).astype(values.dtype)
    save_file(tensors, path, metadata=meta)


def _worn_pads(folder: Path) -> Path:
    gripper = yaml.safe_load(gripper_path("jaw_v1").read_text(encoding="utf-8")) | {"friction": PADS}
    folder.mkdir(parents=True, exist_ok=True)
    path = (folder / "jaw_v1_worn.yaml").resolve()
    path.write_text(yaml.safe_dump(gripper), encoding="utf-8")
    return path
