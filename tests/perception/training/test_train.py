"""Training for real, though not for long."""

from __future__ import annotations

import json
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pickproof.perception.data.scenes import TRAIN_SEED, VALIDATION_SEED
from pickproof.perception.ps6d.loss import SymmetricModel, ps6d_loss
from pickproof.perception.ps6d.network import NetworkConfig, Ps6d, pack
from pickproof.perception.ps6d.variants import VARIANTS
from pickproof.perception.ps6d.weights import file_hash, load_weights, state_hash, weights_record
from pickproof.perception.training.dataset import Sample, collate, train_sample
from pickproof.perception.training.train import put_to_use
from pickproof.perception.training.trainer import Mean, TrainConfig, Trainer, batches, cad_points, kept
from pickproof.scenarios.commands.cli import main
from tests.perception.small_heaps import bracket, fill_folder, small_heaps

pytestmark = pytest.mark.slow


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with settled heaps, so that none need settling."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pickproof.perception.training.train.VALIDATION_HEAPS", 1)
    fill_folder(tmp_path / "out" / "heaps", VALIDATION_SEED, 1)
    fill_folder(tmp_path / "out" / "heaps", TRAIN_SEED, 3)
    return tmp_path


def train(*words: str) -> int:
    return main(["train", "bracket", "--heaps", "3", "--clouds", "6", "--batch", "2", "--loaders", "0", *words])


def initial_network(seed: int) -> Ps6d:
    torch.manual_seed(seed)
    return Ps6d()


def rows(out: Path) -> list[dict[str, float]]:
    return [json.loads(line) for line in (out / "history.jsonl").read_text().splitlines()]


def test_a_short_run_leaves_everything_and_can_be_resumed(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert train() == 0
    out = here / "out" / "train" / "bracket"
    assert {p.name for p in out.iterdir()} == {
        "checkpoint.pt",
        "ps6d.safetensors",
        "record.json",
        "history.jsonl",
        "curves.png",
    }
    (first,) = rows(out)
    assert first["clouds"] >= 6
    assert 0 <= first["right"] <= 1
    # means over the steps taken, of an untrained network: errors of some tenths of the workpiece's longest side
    assert 0.1 < first["train_rotation"] < 2
    assert 0.1 < first["train_translation"] < 2
    assert (out / "curves.png").read_bytes().startswith(b"\x89PNG")
    weights = out / "ps6d.safetensors"
    network = load_weights(weights, bracket())
    record = weights_record(weights)
    assert record == json.loads((out / "record.json").read_text())
    assert record["command"] == "pickproof train bracket --clouds 6 --heaps 3 --batch 2 --loaders 0"
    assert record["clouds"] == first["clouds"]
    assert record["steps"] == first["clouds"] // 2
    assert (record["variant"], record["seed"], record["device"]) == ("ps6d", 0, "cpu")
    assert record["initial_weights"] == state_hash(initial_network(0)) != state_hash(initial_network(1))

    assert train("--resume") == 0
    both = rows(out)
    assert both[0] == first
    assert both[1]["clouds"] >= first["clouds"] + 6
    assert both[1]["seconds"] > first["seconds"]
    again = load_weights(weights, bracket())
    moved = [not torch.equal(a, b) for a, b in zip(network.parameters(), again.parameters(), strict=True)]
    assert all(moved[i] for i, p in enumerate(network.parameters()) if p.ndim > 1)
    resumed = weights_record(weights)
    a, b = resumed["runs"]  # type: ignore[misc]
    assert (a, b["command"]) == (record["runs"][0], record["command"] + " --resume")  # type: ignore[index,operator]
    assert resumed["initial_weights"] == record["initial_weights"] == a["initial_weights"] != b["initial_weights"]
    assert resumed["clouds"] == a["clouds"] + b["clouds"] == both[1]["clouds"]
    assert resumed["steps"] == a["steps"] + b["steps"]

    capsys.readouterr()
    for other in ("plain", "no_normalisation"):  # another architecture, and the same in other units
        assert train("--resume", "--variant", other, "--out", str(out)) == 2
        assert "checkpoint.pt" in capsys.readouterr().err


def test_weights_of_another_run_are_a_start_and_stay_in_the_record(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = ["--clouds", "2", "--batch", "1"]
    assert train(*short, "--out", "first") == 0
    start = here / "first" / "ps6d.safetensors"
    for out, init in (("second", start), ("third", here / "second" / "ps6d.safetensors")):
        assert train(*short, "--init", str(init), "--out", out) == 0
    second, third = (weights_record(here / out / "ps6d.safetensors") for out in ("second", "third"))
    clouds: list[Any] = [weights_record(start)["clouds"], second["clouds"]]
    assert second["init"] == {
        "command": weights_record(start)["command"],
        "clouds": clouds[0],
        "hash": file_hash(start),
        "init": None,
    }
    assert second["initial_weights"] == state_hash(load_weights(start, None))
    assert third["init"]["clouds"] == sum(clouds)  # type: ignore[index]
    assert third["init"]["init"] == second["init"]  # type: ignore[index]
    capsys.readouterr()
    assert train("--init", str(start), "--variant", "no_normalisation") == 2
    assert "no_normalisation" in capsys.readouterr().err
    assert train("--init", "bracket", "--variant", "plain") == 2  # by name: the weights of that variant
    assert "variants/plain.safetensors" in capsys.readouterr().err


def test_resuming_what_is_not_there(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert train("--resume") == 2
    assert "checkpoint.pt" in capsys.readouterr().err
    out = here / "out" / "train" / "bracket"
    (out / "checkpoint.pt").write_bytes(b"not a checkpoint")
    assert train("--resume") == 2
    assert "checkpoint.pt" in capsys.readouterr().err


def test_a_variant_trains_where_it_is_told_and_says_so(here: Path) -> None:
    out = here / "elsewhere"
    assert train("--clouds", "2", "--batch", "1", "--variant", "ppr_net_pp", "--out", str(out)) == 0
    assert str(here) not in (out / "record.json").read_text()  # weights are shipped: no path of this machine in them
    assert load_weights(out / "ps6d.safetensors", bracket()).config == VARIANTS["ppr_net_pp"]
    assert weights_record(out / "ps6d.safetensors")["variant"] == "ppr_net_pp"
    (row,) = rows(out)
    assert 0.1 < row["train_confidence"] < 2  # log 2 for a network that knows nothing


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["--minutes", "0"], ["--minutes", "above 0"]),
        (["--clouds", "-3"], ["--clouds"]),
        (["--batch", "0"], ["--batch"]),
        (["--lr", "-1"], ["--lr"]),
        (["--heaps", "0"], ["--heaps"]),
        (["--loaders", "-1"], ["--loaders"]),
        (["--variant", "ps7d"], ["--variant", "ps6d", "ppr_net_pp"]),
    ],
)
def test_numbers_that_make_no_sense(
    here: Path, words: list[str], names: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert train(*words) == 2
    error = capsys.readouterr().err
    assert all(name in error for name in names)


def test_an_unknown_workpiece(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "brackett"]) == 2
    assert "bracket" in capsys.readouterr().err


def test_two_clouds_are_learned_by_heart() -> None:
    torch.set_num_threads(1)
    torch.manual_seed(0)
    network = Ps6d(NetworkConfig(channels=(24, 48, 96), features=64)).train()  # half the width, a third of the time
    model = SymmetricModel.of(cad_points(bracket(), 16), bracket().symmetry)
    samples = [train_sample(bracket(), small_heaps(), seed=0, index=i) for i in range(2)]
    keep, target = collate(samples, torch.device("cpu"))
    packed = pack([s.graph for s in samples])
    optimiser = torch.optim.AdamW(network.parameters(), 3e-3)
    losses = []
    for _ in range(60):
        loss, _ = ps6d_loss(kept(network(packed), keep), target, model)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.2 * losses[0]
    assert losses[-1] == pytest.approx(min(losses), rel=0.2)


def test_training_leaves_the_global_generator_alone(tmp_path: Path) -> None:
    torch.manual_seed(5)
    before = torch.random.get_rng_state()
    trainers = [Trainer(bracket(), TrainConfig(seed=seed), tmp_path) for seed in (3, 3, 4)]
    assert torch.equal(torch.random.get_rng_state(), before)
    a, b, c = (t.initial_weights for t in trainers)
    assert a == b != c


def test_the_running_mean_follows_the_network_and_is_no_part_of_it() -> None:
    torch.manual_seed(0)
    network = Ps6d()
    mean = Mean(network)
    start = network.state_dict()["shared.first.weight"].clone()
    with torch.no_grad():
        network.shared.first.weight += 1.0
    assert torch.equal(mean.network.state_dict()["shared.first.weight"], start)
    gap = 1.0
    for update in range(1, 7):  # as in exponential moving averages with warm-up: (1 + n) / (10 + n)
        mean.update(network)
        gap *= (1 + update) / (10 + update)
        mine, theirs = (n.state_dict()["shared.first.weight"] for n in (mean.network, network))
        np.testing.assert_allclose((theirs - mine).numpy(), gap, atol=1e-6)


def numbered(seen: list[int]) -> object:
    for i in count():
        seen.append(i)
        yield i


def test_batches_have_no_twins_and_reuse_each_cloud_as_often_as_asked() -> None:
    """Clouds are stood in for by their numbers: what is tested is the order they come in."""
    asked: list[int] = []
    config = TrainConfig(batch=4, reuse=3, buffer=24)
    source = batches(numbered(asked), config, np.random.default_rng(0))  # type: ignore[arg-type]
    drawn: list[Sample] = []
    for _ in range(600):
        batch = next(source)
        assert len({int(i) for i in batch}) == 4  # type: ignore[call-overload]
        drawn += batch
    assert len(drawn) / len(asked) == pytest.approx(3, rel=0.05)
    times = np.bincount(np.array(drawn, dtype=int))
    assert times[24:-24].mean() == pytest.approx(3, rel=0.1)
    assert times[: len(asked) - 24].min() >= 0


def test_the_same_seed_draws_the_same_batches() -> None:
    config = TrainConfig(batch=2, reuse=2, buffer=16)
    runs = []
    for seed in (0, 0, 1):
        source = batches(numbered([]), config, np.random.default_rng(seed))  # type: ignore[arg-type]
        runs.append([next(source) for _ in range(20)])
    assert runs[0] == runs[1] != runs[2]


def test_cad_points_are_on_the_cad_in_units() -> None:
    points = cad_points(bracket(), 200).numpy() * bracket().unit
    assert np.abs(bracket().mesh.nearest.on_surface(points)[1]).max() < 1e-4  # single precision
    assert np.ptp(points, axis=0).max() > 0.8 * bracket().unit


def test_new_weights_are_put_to_use_where_there_are_none(tmp_path: Path) -> None:
    new, used = tmp_path / "new.safetensors", tmp_path / "part" / "ps6d.safetensors"
    new.write_bytes(b"first")
    assert put_to_use(new, used) == f"in use: {used}" and used.read_bytes() == b"first"
    new.write_bytes(b"second")
    assert f"cp {new} {used}" in put_to_use(new, used)
    assert used.read_bytes() == b"first"
