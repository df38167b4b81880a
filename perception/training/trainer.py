"""The state of a training run: network, optimiser, running mean of the weights, history."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Generator, Iterator
from copy import deepcopy
from dataclasses import asdict, dataclass, field
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.optim.swa_utils import get_ema_multi_avg_fn

from pickproof.cell.errors import InputError
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.ps6d.allocator import keep_freed_memory
from pickproof.perception.ps6d.loss import SymmetricModel, ppr_net_loss, ps6d_loss, rotation_loss
from pickproof.perception.ps6d.network import NetworkConfig, Prediction, Ps6d, pack
from pickproof.perception.ps6d.variants import same_variant, variant_of
from pickproof.perception.ps6d.weights import file_hash, load_weights, save_weights, state_hash, weights_record
from pickproof.perception.training.curves import draw_curves
from pickproof.perception.training.dataset import Sample, collate

Batches = Generator[list[Sample], None, None]
EMA_DECAY = 0.998
MODEL_POINTS = 16
"""CAD points compared by the rotation loss."""
MOMENT_POINTS = 2000
"""CAD points of the second moment in PPR-Net's rotation loss."""
WARM_UP = 200  # steps
MAX_GRADIENT = 5.0  # norm


@dataclass
class TrainConfig:
    """What `pickproof train` can be told; defaults are those that made the shipped weights."""

    minutes: float = 60.0
    clouds: int = 200_000
    batch: int = 4
    reuse: int = 4
    buffer: int = 192
    learning_rate: float = 3e-3
    weight_decay: float = 1e-2
    heaps: int = 320
    loaders: int = 1
    seed: int = 0
    validate_every: int = 2000
    init: str = ""
    network: NetworkConfig = field(default_factory=NetworkConfig)


class Mean:
    """Running exponential mean of the network's parameters and statistics: what is validated and shipped."""

    def __init__(self, network: Ps6d) -> None:
        self.network = deepcopy(network)
        self.updates = 0

    @torch.no_grad()
    def update(self, network: Ps6d) -> None:
        """Take one step of training into the mean."""
        self.updates += 1
        decay = min(EMA_DECAY, (1 + self.updates) / (10 + self.updates))
        pairs = list(zip(self.network.state_dict().values(), network.state_dict().values(), strict=True))
        floats = [(mine, theirs) for mine, theirs in pairs if mine.is_floating_point()]
        get_ema_multi_avg_fn(decay)([mine for mine, _ in floats], [theirs for _, theirs in floats], None)
        for mine, theirs in pairs:
            if not mine.is_floating_point():
                mine.copy_(theirs)


def cad_points(workpiece: Workpiece, n: int) -> Tensor:
    """CAD points (n, 3) in units."""
    return torch.from_numpy(workpiece.sample_surface(n, seed=1)[0] / workpiece.unit).float()


def kept(prediction: Prediction, keep: Tensor) -> Prediction:
    """The prediction at the voting points that lie on a workpiece."""
    return Prediction(
        prediction.centres[keep],
        prediction.rotations[keep],
        prediction.cad[keep] if prediction.cad is not None else None,
        prediction.confidence[keep] if prediction.confidence is not None else None,
    )


@torch.no_grad()
def validate(network: Ps6d, samples: list[Sample], model: SymmetricModel, device: torch.device) -> dict[str, float]:
    """Median errors in units over held-out overhead views, and the share of voting points that are right.

    A voting point is right with a centre within 0.1 units and a rotation error within 0.1 units.
    """
    network.eval()
    centre, rotation = [], []
    for sample in samples:
        keep, target = collate([sample], device)
        prediction = kept(network(pack([sample.graph], device)), keep)
        centre.append((prediction.centres - target.centres).norm(dim=1).cpu().numpy())
        rotation.append(rotation_loss(prediction.rotations, target.rotations, model).cpu().numpy())
    c, r = np.concatenate(centre), np.concatenate(rotation)
    return {
        "centre": float(np.median(c)),
        "rotation": float(np.median(r)),
        "right": float(((c < 0.1) & (r < 0.1)).mean()),
    }


def batches(samples: Iterator[Sample], config: TrainConfig, rng: np.random.Generator) -> Batches:
    """Batches from a replay buffer: rendering a cloud costs more than reading it again with other batch mates."""
    buffer: list[Sample] = []
    owed = 0.0
    place = 0
    while True:
        owed += config.batch / config.reuse
        while owed >= 1 or len(buffer) < 4 * config.batch:
            sample = next(samples)
            if len(buffer) < config.buffer:
                buffer.append(sample)
            else:
                buffer[place % config.buffer] = sample
            place += 1
            owed = max(owed - 1, 0.0)
        chosen = rng.choice(len(buffer), config.batch, replace=False)
        yield [buffer[i] for i in chosen]


class Trainer:
    """One network learning one workpiece.

    Attributes:
        start: monotonic time at which this run began.
        clouds: seen in all runs, `start_clouds` of them before this one; `steps` likewise.
        history: one row of validation figures for each validation of all runs.
        runs: what was asked of each run, and how far it came.
        command: the command line of this run, for the record.
    """

    def __init__(self, workpiece: Workpiece, config: TrainConfig, out: Path, command: str = "") -> None:
        self.workpiece, self.config, self.out, self.command = workpiece, config, out, command
        self.device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        if self.device.type == "cpu":
            torch.set_num_threads(1)
            keep_freed_memory()
        self.network = _new_network(config).to(self.device)
        self.init = _initialise(self.network, Path(config.init)) if config.init else None
        self.history: list[dict[str, float]] = []
        self.runs: list[dict[str, object]] = []
        self.clouds = self.start_clouds = self.steps = self.start_steps = 0
        self.seconds_before = 0.0
        self.start = time.monotonic()
        self._sums: dict[str, Tensor] = {}
        self._summed = 0
        self.model = SymmetricModel.of(cad_points(workpiece, MODEL_POINTS), workpiece.symmetry).to(self.device)
        self._moments = SymmetricModel.of(cad_points(workpiece, MOMENT_POINTS), workpiece.symmetry).to(self.device)
        self._begin()

    def _begin(self) -> None:
        c = self.config
        self.initial_weights = state_hash(self.network)
        self.optimiser = torch.optim.AdamW(
            self.network.parameters(), c.learning_rate, weight_decay=c.weight_decay, fused=True
        )
        self.mean = Mean(self.network)

    def resume(self) -> None:
        """Go on from the checkpoint in the output folder, with a new optimiser and a new cosine.

        Raises:
            InputError: no checkpoint, or one of another network.
        """
        path = self.out / "checkpoint.pt"
        if not path.is_file():
            raise InputError(path, "", "missing file", "the checkpoint of an earlier run; leave out --resume to begin")
        try:
            stored = torch.load(path, map_location=self.device, weights_only=True)
            if "network_config" in stored and stored["network_config"] != asdict(self.config.network):
                raise ValueError(f"trained as {stored['network_config']}")
            self.network.load_state_dict(stored["network"])
            self.history, self.runs, self.init = stored["history"], stored.get("runs", []), stored.get("init")
            self.clouds = self.start_clouds = stored["clouds"]
            self.steps = self.start_steps = stored.get("steps", 0)
            self.seconds_before = stored["seconds"]
        except (RuntimeError, KeyError, TypeError, ValueError, EOFError, OSError, UnpicklingError) as error:
            raise InputError(path, "", str(error).splitlines()[0], "a checkpoint of the same network") from None
        self._begin()

    @property
    def seconds(self) -> float:
        """Wall time of all runs in [s]."""
        return self.seconds_before + time.monotonic() - self.start

    @property
    def done(self) -> float:
        """Share of this run that is over, in [0, 1]."""
        minutes = (time.monotonic() - self.start) / 60
        return min(max((self.clouds - self.start_clouds) / self.config.clouds, minutes / self.config.minutes), 1.0)

    def step(self, batch: list[Sample]) -> Tensor:
        """One step of the optimiser; returns the loss, in the network's units of length, without waiting for it."""
        warm = min(1.0, (self.steps - self.start_steps + 1) / WARM_UP)
        for group in self.optimiser.param_groups:
            group["lr"] = self.config.learning_rate * warm * 0.5 * (1 + math.cos(math.pi * self.done))
        self.network.train()
        keep, target = collate(batch, self.device)
        prediction = kept(self.network(pack([s.graph for s in batch], self.device)), keep)
        if self.config.network.heads == "ppr_net":
            loss, parts = ppr_net_loss(prediction, target, self._moments)
        else:
            loss, parts = ps6d_loss(prediction, target, self.model)
        loss = loss * self.config.network.scale
        self.optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), MAX_GRADIENT, foreach=True)
        self.optimiser.step()
        self.mean.update(self.network)
        self.steps += 1
        self.clouds += len(batch)
        self._summed += 1
        for key, value in parts.items():
            self._sums[key] = self._sums[key] + value if key in self._sums else value
        return loss.detach()

    def record(self, validation: list[Sample]) -> dict[str, float]:
        """Validate the mean weights, then write checkpoint, weights, history and curves; returns the new row."""
        scores = validate(self.mean.network, validation, self.model, self.device)
        row = {"clouds": self.clouds, "seconds": self.seconds, **scores}
        row |= {f"train_{key}": float(value) / max(self._summed, 1) for key, value in self._sums.items()}
        self._sums, self._summed = {}, 0
        self.history.append(row)
        (self.out / "history.jsonl").write_text("".join(json.dumps(r) + "\n" for r in self.history))
        runs = [*self.runs, self._run()]
        state = {
            "network": self.mean.network.state_dict(),
            "network_config": asdict(self.config.network),
            "history": self.history,
            "runs": runs,
            "init": self.init,
            "clouds": self.clouds,
            "steps": self.steps,
            "seconds": self.seconds,
        }
        part = self.out / "checkpoint.part"
        torch.save(state, part)
        part.replace(self.out / "checkpoint.pt")
        record = self._record(runs, row)
        save_weights(self.out / "ps6d.safetensors", self.mean.network, self.workpiece, record)
        (self.out / "record.json").write_text(json.dumps(record, indent=1) + "\n")
        draw_curves(self.history, self.out / "curves.png", f"{self.workpiece.name}, {record['variant']}")
        return row

    def _run(self) -> dict[str, object]:
        """This run alone."""
        return {
            "command": self.command,
            "steps": self.steps - self.start_steps,
            "clouds": self.clouds - self.start_clouds,
            "seconds": round(self.seconds - self.seconds_before, 1),
            "seed": self.config.seed,
            "initial_weights": self.initial_weights,
            "device": _device_name(self.device),
            "torch": str(torch.__version__),
        }

    def _record(self, runs: list[dict[str, object]], row: dict[str, float]) -> dict[str, object]:
        """How the weights came about: totals of all runs, then each run, oldest first."""
        return {
            **runs[-1],
            "variant": variant_of(self.config.network),
            "steps": self.steps,
            "clouds": self.clouds,
            "seconds": round(self.seconds),
            "initial_weights": runs[0]["initial_weights"],
            "init": self.init,
            "parameters": sum(p.numel() for p in self.network.parameters()),
            "config": {key: value for key, value in asdict(self.config).items() if key != "init"},
            "validation": row,
            "runs": runs,
        }


def _new_network(config: TrainConfig) -> Ps6d:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        return Ps6d(config.network)


def _initialise(network: Ps6d, path: Path) -> dict[str, object]:
    """Take over the weights in a file; returns what the record keeps of it, `clouds` being those of all its history."""
    start = load_weights(path, None)
    try:
        if not same_variant(start.config, network.config):
            raise RuntimeError(f"variant {variant_of(start.config)}")
        network.load_state_dict(start.state_dict())
    except RuntimeError as error:
        valid = f"weights of the same network ({variant_of(network.config)})"
        raise InputError(path, "", str(error).splitlines()[0], valid) from None
    record: dict[str, Any] = weights_record(path)
    before = record.get("init") or {"clouds": 0}
    clouds = record.get("clouds", 0) + before["clouds"]
    return {"command": record.get("command"), "clouds": clouds, "hash": file_hash(path), "init": record.get("init")}


def _device_name(device: torch.device) -> str:
    return torch.cuda.get_device_name(device) if device.type == "cuda" else device.type
