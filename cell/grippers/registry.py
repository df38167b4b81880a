"""Grippers by name: the `kind` in each YAML file decides which other fields it has."""

from __future__ import annotations

from pathlib import Path

from pickproof.cell.config import parse, read_yaml
from pickproof.cell.errors import InputError, did_you_mean
from pickproof.cell.grippers.magnet import Magnet, MagnetConfig
from pickproof.cell.grippers.parallel_jaw import JawConfig, ParallelJaw
from pickproof.cell.grippers.vacuum import VacuumConfig, VacuumGripper

SHIPPED = Path(__file__).resolve().parent
KINDS: dict[str, type[JawConfig] | type[VacuumConfig] | type[MagnetConfig]] = {
    "parallel_jaw": JawConfig,
    "vacuum": VacuumConfig,
    "magnet": MagnetConfig,
}


def list_grippers() -> list[str]:
    """Names of the shipped grippers."""
    return sorted(path.stem for path in SHIPPED.glob("*.yaml"))


def gripper_path(name: str) -> Path:
    """Path of the YAML file of a gripper that is given by its shipped name or by a path."""
    return Path(name) if name.endswith((".yaml", ".yml")) else SHIPPED / f"{name}.yaml"


def load_gripper(name: str) -> ParallelJaw | VacuumGripper | Magnet:
    """Load a shipped gripper by name, or any by the path of its YAML file; `kind` is parallel_jaw when left out.

    Raises:
        InputError: no such gripper, or an invalid file.
    """
    path = gripper_path(name)
    if not path.is_file():
        known = list_grippers()
        valid = f"one of: {', '.join(known)}, or a YAML file{did_you_mean(name, known)}"
        raise InputError("command line", "gripper", name, valid)
    data = read_yaml(path)
    kind = str(data.get("kind", "parallel_jaw"))
    if kind not in KINDS:
        raise InputError(path, "kind", kind, f"one of: {', '.join(KINDS)}")
    return parse(KINDS[kind], data, path).build()
