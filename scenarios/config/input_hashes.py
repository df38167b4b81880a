"""Hashes of the inputs that decide a result besides the scenario: the files that it names, and the software.

Paths and times are not part of them, so a campaign can be continued on another machine with the same files.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from platform import python_version
from typing import Any

from pickproof.cell.config import read_yaml
from pickproof.cell.grippers.registry import gripper_path
from pickproof.cell.numerics import profile
from pickproof.cell.workpiece.workpiece import search_path
from pickproof.scenarios.config.scenario import Scenario

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("cell", "perception", "grasping", "robots", "scenarios")
PACKAGES = (
    "pickproof", "numpy", "scipy", "pybullet", "torch", "open3d", "embreex", "trimesh", "pin", "coal", "ompl", "ruckig",
    "py-opw-kinematics", "numba", "llvmlite", "opencv-contrib-python-headless", "manifold3d",
)  # fmt: skip


def input_hashes(scenario: Scenario, oracle: Collection[str]) -> dict[str, str]:
    """SHA-256 of every file that an episode reads, by its role; empty where there is none.

    Weights have a hash of their own (`scenarios.config.scenario.weights_used`). The content of the files is not checked
    here; `scenarios.picking.workcell.check_inputs` does that.

    Raises:
        InputError: workpiece.yaml is not readable.
    """
    folders = (root / scenario.workpiece for root in search_path())
    folder = next((f for f in folders if (f / "workpiece.yaml").is_file()), None)
    files: dict[str, list[Path]] = {
        "gripper": [gripper_path(scenario.gripper)],
        "robot": sorted((ROOT / "robots" / scenario.robot).glob("**/*")),
    }
    if folder is not None:
        config = read_yaml(folder / "workpiece.yaml")
        files |= {name: [folder / name] for name in ("workpiece.yaml", "grasps.yaml")}
        if scenario.grasps:
            files["grasps.yaml"] = [Path(scenario.grasps)]
        files["mesh"] = [folder / str(config.get("mesh"))]
        files["collision_hulls"] = [folder / str(config["collision_hulls"])] if config.get("collision_hulls") else []
        if "perception" not in oracle:
            files["score.json"] = [folder / "score.json"]
    return {name: _digest(files[name]) for name in sorted(files)}


def inputs_hash(hashes: Mapping[str, str]) -> str:
    """One SHA-256 over `input_hashes`."""
    return hashlib.sha256(json.dumps(hashes, sort_keys=True).encode()).hexdigest()


@cache
def versions() -> dict[str, str]:
    """Versions of the software that decides the results; `code` is a hash of pickproof's own source.

    `numerics` is the numeric profile of the processes that run the episodes.
    """
    found = {"python": python_version(), "numerics": profile()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    sources = (path for room in ROOMS for path in (ROOT / room).glob("**/*.py"))
    return found | {"code": _digest(sorted(sources))[:16]}


def changed(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Entries of `now` that differ from the recorded ones: keys, and `inputs.mesh`, `versions.numpy` for single
    entries.

    Results older than a key do not contain it; then the key itself is named.
    """
    names = []
    for key, value in now.items():
        was = before.get(key)
        if was and isinstance(was, Mapping) and isinstance(value, Mapping):
            names += [f"{key}.{n}" for n in sorted(was.keys() | value.keys()) if was.get(n) != value.get(n)]
        elif was != value:
            names.append(key)
    return names


def _digest(files: Iterable[Path]) -> str:
    """SHA-256 over names and contents; empty where none of the files exists."""
    digest, found = hashlib.sha256(), False
    for file in files:
        if file.is_file():
            content = file.read_bytes()
            digest.update(f"{file.name} {len(content)}\n".encode() + content)
            found = True
    return digest.hexdigest() if found else ""
