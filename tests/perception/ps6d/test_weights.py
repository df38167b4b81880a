from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from pickproof.cell.errors import InputError
from pickproof.perception.ps6d.network import NetworkConfig, Ps6d
from pickproof.perception.ps6d.point_hierarchy import VOXELS
from pickproof.perception.ps6d.weights import (
    file_hash,
    load_weights,
    save_weights,
    state_hash,
    weights_path,
    weights_record,
)
from tests.perception.small_heaps import bracket

SMALL = NetworkConfig(channels=(8, 12, 16), features=16)


def small_network(seed: int = 0, config: NetworkConfig = SMALL) -> Ps6d:
    torch.manual_seed(seed)
    return Ps6d(config)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "new" / "ps6d.safetensors"
    save_weights(path, small_network(), bracket(), {"clouds": 12, "command": "pickproof train bracket"})
    return path


def rewrite(path: Path, meta: dict[str, str] | None = None, **tensors: torch.Tensor) -> None:
    """Change metadata and tensors of a weight file."""
    with safe_open(path, framework="pt") as file:
        old = dict(file.metadata())
    save_file(load_file(path) | tensors, path, metadata=old | (meta or {}))


@pytest.mark.parametrize("config", [SMALL, replace(SMALL, local_frames=False, cad_head=False)])
def test_what_is_saved_comes_back_in_half_precision(tmp_path: Path, config: NetworkConfig) -> None:
    network, path = small_network(config=config), tmp_path / "w.safetensors"
    network.block1.norm.num_batches_tracked += 77
    save_weights(path, network, bracket(), {"clouds": 12})
    back = load_weights(path, bracket())
    assert back.config == config
    assert not back.training
    for (name, a), b in zip(network.state_dict().items(), back.state_dict().values(), strict=True):
        assert b.dtype == a.dtype
        torch.testing.assert_close(b, a.half().to(a.dtype), rtol=0, atol=0, msg=name)
        torch.testing.assert_close(b, a, rtol=1e-3, atol=1e-6, msg=name)
    assert weights_record(path) == {"clouds": 12}
    assert path.stat().st_size < 2.2 * sum(p.numel() for p in network.state_dict().values()) + 20_000
    assert [p.name for p in tmp_path.iterdir()] == ["w.safetensors"]


def test_half_precision_survives_any_number_of_round_trips(path: Path) -> None:
    tensors = load_file(path)
    save_weights(path, load_weights(path, bracket()), bracket(), weights_record(path))
    for name, tensor in load_file(path).items():
        assert torch.equal(tensor, tensors[name]), name


def test_the_hash_is_of_the_bytes(path: Path, tmp_path: Path) -> None:
    shutil.copy(path, tmp_path / "copy.safetensors")
    assert file_hash(tmp_path / "copy.safetensors") == file_hash(path)
    save_weights(path, small_network(seed=1), bracket(), weights_record(path))
    assert file_hash(tmp_path / "copy.safetensors") != file_hash(path)


def says(path: Path, *names: str, workpiece: Any = None) -> None:
    with pytest.raises(InputError) as caught:
        load_weights(path, workpiece or bracket())
    for name in (str(path), "pickproof train bracket", *names):
        assert name in str(caught.value)


def test_a_missing_file(tmp_path: Path) -> None:
    says(tmp_path / "none.safetensors", "missing file")
    says(tmp_path, "missing file")


@pytest.mark.parametrize("keep", [0, 5, 100, 0.5, 0.999])
def test_a_truncated_file(path: Path, keep: float) -> None:
    whole = path.read_bytes()
    path.write_bytes(whole[: int(keep * len(whole)) if isinstance(keep, float) else keep])
    says(path, "corrupt")


def test_a_file_of_something_else(path: Path) -> None:
    path.write_text("name: bracket\n" * 200)
    says(path, "corrupt")
    save_file({"x": torch.zeros(3)}, path)
    says(path, "schema", "None")


def test_weights_of_another_workpiece(path: Path) -> None:
    rewrite(path, {"workpiece": "gear_shaft"})
    says(path, "workpiece", "'gear_shaft'", "bracket")
    assert load_weights(path, None).config == SMALL  # as a start for another


def test_weights_of_a_workpiece_that_has_changed_its_unit(path: Path) -> None:
    with safe_open(path, framework="pt") as file:
        assert float(file.metadata()["unit"]) == bracket().unit
    for unit in ("0.1", "nan", "long"):
        rewrite(path, {"unit": unit})
        says(path, "unit", unit, str(bracket().unit))
    assert load_weights(path, None).config == SMALL


def test_weights_of_other_levels(path: Path) -> None:
    rewrite(path, {"voxels": "[0.03, 0.1, 0.2, 0.4]"})
    says(path, "voxels", "0.1", str(VOXELS[1]))


def test_the_hash_of_a_network_is_of_its_values() -> None:
    assert state_hash(small_network()) == state_hash(small_network()) != state_hash(small_network(seed=1))
    network = small_network()
    network.block1.norm.running_mean += 1e-6
    assert state_hash(network) != state_hash(small_network())


def test_weights_of_another_schema(path: Path) -> None:
    rewrite(path, {"schema": "99"})
    says(path, "schema", "'99'")


@pytest.mark.parametrize(
    "network",
    [
        "",
        "[]",
        "3",
        "{",
        json.dumps({"channels": 3}),
        json.dumps({"channels": [8, 12, 16], "width": 3}),
        json.dumps({"channels": [8, 12, 16], "backbone": "resnet"}),
    ],
)
def test_a_network_that_is_not_described(path: Path, network: str) -> None:
    rewrite(path, {"network": network})
    says(path, "network")


def test_other_tensors_than_described(path: Path) -> None:
    rewrite(path, {"network": json.dumps({"channels": [8, 12, 24], "features": 16})})
    says(path, "tensors")
    rewrite(path, None, extra=torch.zeros(3))
    says(path, "tensors")


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_values_that_are_not_finite(path: Path, bad: float) -> None:
    weight = load_file(path)["centre_head.second.weight"]
    weight[0, 0] = bad
    rewrite(path, None, **{"centre_head.second.weight": weight})
    says(path, "not finite")


def test_a_network_that_overflows_half_precision_is_not_loaded(tmp_path: Path) -> None:
    network, path = small_network(), tmp_path / "w.safetensors"
    with torch.no_grad():
        network.shared.first.weight[0, 0] = 1e6
    save_weights(path, network, bracket(), {})
    says(path, "not finite")


def test_the_shipped_weights_load_and_say_how_they_were_made() -> None:
    path = weights_path(bracket())
    assert load_weights(path, bracket()).config.local_frames
    record = weights_record(path)
    assert str(record["command"]).startswith("pickproof train bracket")
    assert isinstance(record["clouds"], int) and record["clouds"] > 1000
