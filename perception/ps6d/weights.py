"""Weight files: safetensors in fp16, with the record of how they were made, loaded strictly."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from pickproof.cell.errors import InputError
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.ps6d.network import NetworkConfig, Ps6d
from pickproof.perception.ps6d.point_hierarchy import VOXELS

WEIGHTS_SCHEMA = 1


def weights_path(workpiece: Workpiece) -> Path:
    """Where a workpiece's shipped weights lie."""
    return workpiece.folder / "ps6d.safetensors"


def variant_path(workpiece: Workpiece, variant: str) -> Path:
    """Where the weights lie that a peer or an ablation was given for the benchmark."""
    return workpiece.folder / "variants" / f"{variant}.safetensors"


def file_hash(path: Path) -> str:
    """First 16 hex digits of the file's SHA-256."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def state_hash(network: Ps6d) -> str:
    """First 16 hex digits of the SHA-256 of a network's parameters and statistics."""
    digest = hashlib.sha256()
    for value in network.state_dict().values():
        digest.update(value.cpu().numpy().tobytes())
    return digest.hexdigest()[:16]


def save_weights(path: Path, network: Ps6d, workpiece: Workpiece, record: dict[str, object]) -> None:
    """Write the weights as fp16; `record` (command, clouds seen, seed, ...) is kept in the file's metadata."""
    tensors = {
        key: (value.half() if value.is_floating_point() else value).contiguous().cpu()
        for key, value in network.state_dict().items()
    }
    meta = {
        "schema": str(WEIGHTS_SCHEMA),
        "workpiece": workpiece.name,
        "unit": repr(workpiece.unit),
        "voxels": json.dumps(VOXELS),
        "network": json.dumps(asdict(network.config)),
        "record": json.dumps(record),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    save_file(tensors, part, metadata=meta)
    part.replace(path)


def load_weights(path: Path, workpiece: Workpiece | None) -> Ps6d:
    """The network with its weights, in evaluation mode, on the CPU in fp32.

    Args:
        workpiece: whose weights they must be; None to take any, as a start for training another.

    Raises:
        InputError: missing, corrupt, of another workpiece, or of another architecture.
    """
    remedy = f"weights written by `pickproof train {workpiece.name if workpiece else 'WORKPIECE'}`"
    if not path.is_file():
        raise InputError(path, "", "missing file", remedy)
    try:
        with safe_open(path, framework="pt") as file:
            meta = file.metadata() or {}
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  not a dict
    except (SafetensorError, OSError) as error:
        raise InputError(path, "", f"corrupt file ({error})", remedy) from None
    if meta.get("schema") != str(WEIGHTS_SCHEMA):
        raise InputError(path, "schema", meta.get("schema"), f"{WEIGHTS_SCHEMA}; {remedy}")
    if workpiece is not None and meta.get("workpiece") != workpiece.name:
        raise InputError(path, "workpiece", meta.get("workpiece"), f"{workpiece.name}; {remedy}")
    if workpiece is not None and "unit" in meta and not _is_near(meta["unit"], workpiece.unit):
        raise InputError(path, "unit", meta["unit"], f"{workpiece.unit!r}, the workpiece's unit in [m]; {remedy}")
    if meta.get("voxels", json.dumps(VOXELS)) != json.dumps(VOXELS):
        raise InputError(path, "voxels", meta["voxels"], f"{json.dumps(VOXELS)}, the levels of the cloud; {remedy}")
    try:
        sizes = json.loads(meta["network"])
        network = Ps6d(NetworkConfig(**(sizes | {"channels": tuple(sizes["channels"])})))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(path, "network", f"{type(error).__name__}: {error}", remedy) from None
    try:
        network.load_state_dict({k: v.float() if v.is_floating_point() else v for k, v in tensors.items()}, strict=True)
    except RuntimeError as error:
        raise InputError(path, "tensors", str(error).splitlines()[0], remedy) from None
    if not all(torch.isfinite(v).all() for v in network.state_dict().values() if v.is_floating_point()):
        raise InputError(path, "tensors", "values that are not finite", remedy)
    return network.eval()


def _is_near(text: str, value: float) -> bool:
    try:
        return abs(float(text) - value) <= 1e-6 * value
    except ValueError:
        return False


def weights_record(path: Path) -> dict[str, object]:
    """The record kept in a weight file."""
    with safe_open(path, framework="pt") as file:
        record: dict[str, object] = json.loads((file.metadata() or {}).get("record", "{}"))
    return record
