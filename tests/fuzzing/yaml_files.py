"""Shipped YAML files with values, units and structure spoiled: scenario, workpiece, grasps, gripper, robot."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pickproof.cell.config import load, read_yaml
from pickproof.cell.errors import InputError
from pickproof.cell.grippers.registry import SHIPPED as GRIPPERS
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.workpiece.workpiece import WorkpieceConfig
from pickproof.grasping.grasp_points import read_table
from pickproof.robots.kinematics.model import RobotConfig
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.config.shipped import WORKPIECES
from tests.fuzzing.mutate import holder, mutated, scaled, with_garbage

ROOT = WORKPIECES.parent.parent
SOURCES = {
    "scenario": WORKPIECES.parent / "bracket.yaml",
    "workpiece": WORKPIECES / "bracket" / "workpiece.yaml",
    "grasps": WORKPIECES / "bracket" / "grasps.yaml",
    "gripper": GRIPPERS / "jaw_v1.yaml",
    "robot": ROOT / "robots" / "lrmate200id" / "robot.yaml",
}
LENGTHS: dict[str, list[tuple[Any, ...]]] = {
    "scenario": [("source_bin", "inner"), ("source_bin", "position"), ("place_bin", "wall"), ("place_bin", "inner")],
    "workpiece": [("heap", "bin_inner"), ("heap", "camera_distance"), ("collision_boxes", 0, "size"), ("tolerance",)],
    "grasps": [("grasps", 0, "centre"), ("grasps", 0, "width")],
    "gripper": [("max_opening",), ("finger_size",), ("body", 0, "size"), ("flange_to_tcp",)],
    "robot": [("reach",), ("opw", "c1")],
}
"""Fields in [m] that stand in those files."""
WRONG = "# a length in mm: to be refused\n"
TEXTS = (
    "a: &a [*a]\n",
    "a: 2023-02-30\n",
    "? {a: 1}\n: 2\n",
    "a: " + "[" * 3000 + "\n",
    "<<: {name: x}\n",
    "- 1\n",
    "a: !!python/object:os.system x\n",
    "%YAML 9.9\n---\na: 1\n",
)


def hostile(rng: np.random.Generator) -> tuple[str, bytes]:
    """Suffix (`.scenario.yaml` and so on) and content of a file; some are in order."""
    kind = str(rng.choice(list(SOURCES)))
    suffix = f".{kind}.yaml"
    document: Any = read_yaml(SOURCES[kind])
    how = rng.random()
    if how < 0.05:
        return suffix, rng.bytes(int(rng.integers(0, 200)))
    if how < 0.3:
        path = LENGTHS[kind][rng.integers(len(LENGTHS[kind]))]
        inside = holder(document, path)
        if path[-1] in inside:
            inside[path[-1]] = scaled(inside[path[-1]], 1000.0)
            return suffix, (WRONG + dumped(document)).encode()
    for _ in range(rng.integers(0, 4)):
        document = mutated(copy.deepcopy(document), rng)
    content = dumped(document).encode()
    if how > 0.9:
        content += rng.choice(TEXTS).encode()
    elif how > 0.8:
        content += content.splitlines(keepends=True)[0]  # a field that stands twice
    elif how > 0.65:
        content = with_garbage(content, rng)
    return suffix, content


def dumped(document: Any) -> str:
    return str(yaml.safe_dump(document, sort_keys=False, width=120))


READERS: dict[str, Callable[[Path], object]] = {
    "scenario": lambda path: load_scenario(str(path)),
    "workpiece": lambda path: load(WorkpieceConfig, path),
    "grasps": read_table,
    "gripper": lambda path: load_gripper(str(path)),
    "robot": lambda path: load(RobotConfig, path),
}


def check(path: Path) -> str:
    """`read` where a file fits its schema, `refused` where it gives a reason.

    Raises:
        AssertionError: a length in mm was taken for one in m.
    """
    try:
        READERS[path.suffixes[-2][1:]](path)
    except InputError as error:
        assert str(error).strip() and error.valid
        return "refused"
    assert not path.read_text(errors="replace").startswith(WRONG), "took mm for m"
    return "read"
