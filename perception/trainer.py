"""The state of a training run: network, optimiser, running mean of the weights, history."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Generator, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from pickle import UnpicklingError

import numpy as np
import torch
from torch import Tensor

from cell.errors import InputError
from cell.workpiece import Workpiece
from perception.curves import draw_curves
from perception.dataset import Sample, collate
from perception.loss import SymmetricModel, ps6d_loss, rotation_loss
from perception.network import NetworkConfig, Prediction, Ps6d, pack
from perception.weights import load_weights, save_weights

Batches = Generator[list[Sample], None, None]
EMA_DECAY = 0.998
MODEL_POINTS = 16
"""CAD points compared by the rotation loss."""
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
        self.network = Ps6d(network.config).to(next(network.parameters()).device)
        self.network.load_state_dict(network.state_dict())
        self.updates = 0

    @torch.no_grad()
    def update(self, network: Ps6d) -> None:
        self.updates += 1
        decay = min(EMA_DECAY, (1 + self.updates) / (10 + self.updates))
        for mine, theirs in zip(self.network.state_dict().values(), network.state_dict().values(), strict=True):
            if mine.is_floating_point():
                mine.lerp_(theirs, 1 - decay)
            else:
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
        clouds: seen in all runs, `start_clouds` of them before this one.
        history: one row of validation figures for each validation of all runs.
    """

    def __init__(self, workpiece: Workpiece, config: TrainConfig, out: Path) -> None:
        self.workpiece, self.config, self.out = workpiece, config, out
        self.device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        if self.device.type == "cpu":
            torch.set_num_threads(1)
        torch.manual_seed(config.seed)
        self.network = Ps6d(config.network).to(self.device)
        if config.init:
            self.network.load_state_dict(load_weights(Path(config.init), None).state_dict())
        self.history: list[dict[str, float]] = []
        self.clouds = self.start_clouds = 0
        self.seconds_before = 0.0
        self.steps = 0
        self.start = time.monotonic()
        self._sums: dict[str, float] = {}
        self._summed = 0
        self.model = SymmetricModel.of(cad_points(workpiece, MODEL_POINTS), workpiece.symmetry).to(self.device)
        self._begin()

    def _begin(self) -> None:
        c = self.config
        self.optimiser = torch.optim.AdamW(self.network.parameters(), c.learning_rate, weight_decay=c.weight_decay)
        self.mean = Mean(self.network)

    def resume(self) -> None:
        """Go on from the checkpoint in the output folder, with a new optimiser and a new cosine.

        Raises:
            InputError: there is none, or it is not one of this network.
        """
        path = self.out / "checkpoint.pt"
        if not path.is_file():
            raise InputError(path, "", "missing file", "a checkpoint of an earlier run; leave out --resume")
        try:
            stored = torch.load(path, map_location=self.device, weights_only=True)
            self.network.load_state_dict(stored["network"])
            self.history = stored["history"]
            self.clouds = self.start_clouds = stored["clouds"]
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

    def step(self, batch: list[Sample]) -> float:
        """One step of the optimiser; returns the loss in units."""
        warm = min(1.0, (self.steps + 1) / WARM_UP)
        for group in self.optimiser.param_groups:
            group["lr"] = self.config.learning_rate * warm * 0.5 * (1 + math.cos(math.pi * self.done))
        self.network.train()
        keep, target = collate(batch, self.device)
        prediction = kept(self.network(pack([s.graph for s in batch], self.device)), keep)
        loss, parts = ps6d_loss(prediction, target, self.model)
        self.optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), MAX_GRADIENT)
        self.optimiser.step()
        self.mean.update(self.network)
        self.steps += 1
        self.clouds += len(batch)
        self._summed += 1
        for key, value in parts.items():
            self._sums[key] = self._sums.get(key, 0.0) + float(value)
        return float(loss.detach())

    def record(self, validation: list[Sample]) -> dict[str, float]:
        """Validate the mean weights, then write checkpoint, weights, history and curves; returns the new row."""
        scores = validate(self.mean.network, validation, self.model, self.device)
        row = {"clouds": self.clouds, "seconds": self.seconds, **scores}
        row |= {f"train_{key}": value / max(self._summed, 1) for key, value in self._sums.items()}
        self._sums, self._summed = {}, 0
        self.history.append(row)
        (self.out / "history.jsonl").write_text("".join(json.dumps(r) + "\n" for r in self.history))
        state = {
            "network": self.mean.network.state_dict(),
            "history": self.history,
            "clouds": self.clouds,
            "seconds": self.seconds,
        }
        part = self.out / "checkpoint.part"
        torch.save(state, part)
        part.replace(self.out / "checkpoint.pt")
        record: dict[str, object] = {
            "command": f"pickproof train {self.workpiece.name}",
            "clouds": self.clouds,
            "seconds": round(self.seconds),
            "device": self.device.type,
            "config": asdict(self.config),
            "validation": row,
            "torch": torch.__version__,
        }
        save_weights(self.out / "ps6d.safetensors", self.mean.network, self.workpiece, record)
        draw_curves(self.history, self.out / "curves.png", self.workpiece.name)
        return row
