"""Training PS6D for one workpiece: streamed scenes, resumable, on the CPU or on CUDA, chosen by itself."""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from torch import Tensor

from cell.errors import InputError
from cell.workpiece import Workpiece, load_workpiece
from perception.curves import draw_curves
from perception.dataset import Sample, collate, make_sample, stream
from perception.loss import SymmetricModel, ps6d_loss, rotation_loss
from perception.network import NetworkConfig, Prediction, Ps6d, pack
from perception.scenes import TRAIN_SEED, VALIDATION_SEED, load_heaps, overhead_view
from perception.weights import save_weights

EMA_DECAY = 0.998
MODEL_POINTS = 16
"""CAD points compared by the rotation loss."""


@dataclass
class TrainConfig:
    """What `pickproof train` can be told; defaults are those that made the shipped weights."""

    minutes: float = 120.0
    clouds: int = 200_000
    batch: int = 4
    reuse: int = 3
    buffer: int = 192
    learning_rate: float = 3e-3
    weight_decay: float = 1e-2
    heaps: int = 320
    loaders: int = 1
    seed: int = 0
    validate_every: int = 2000
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


def batches(samples: Iterator[Sample], config: TrainConfig, rng: np.random.Generator) -> Iterator[list[Sample]]:
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


def train(workpiece: Workpiece, config: TrainConfig, out: Path, resume: bool, console: Console) -> Path:
    """Train and write checkpoint, weights, log and curves to `out`; returns the path of the weights.

    The learning rate falls as a cosine to zero at `clouds` or `minutes`, whichever comes first; resuming starts the
    cosine anew from the stored weights.
    """
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if device.type == "cpu":
        torch.set_num_threads(1)
    out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(config.seed)
    network = Ps6d(config.network).to(device)
    history: list[dict[str, float]] = []
    before = 0
    seconds_before = 0.0
    checkpoint = out / "checkpoint.pt"
    if resume:
        if not checkpoint.is_file():
            raise InputError(checkpoint, "", "missing file", "a checkpoint of an earlier run; leave out --resume")
        stored = torch.load(checkpoint, map_location=device, weights_only=True)
        network.load_state_dict(stored["network"])
        history, before, seconds_before = stored["history"], stored["clouds"], stored["seconds"]
    optimiser = torch.optim.AdamW(network.parameters(), config.learning_rate, weight_decay=config.weight_decay)
    mean = Mean(network)
    model = SymmetricModel.of(cad_points(workpiece, MODEL_POINTS), workpiece.symmetry).to(device)

    folder = Path("out") / "heaps"
    with Progress(TextColumn("settling heaps"), BarColumn(), MofNCompleteColumn(), console=console) as bar:
        task = bar.add_task("", total=config.heaps + 16)
        tick = lambda offset: lambda n: bar.update(task, completed=offset + n)  # noqa: E731
        held = load_heaps(workpiece, VALIDATION_SEED, 16, folder, os.cpu_count() or 1, tick(0))
        heaps = load_heaps(workpiece, TRAIN_SEED, config.heaps, folder, os.cpu_count() or 1, tick(16))
    view = overhead_view(workpiece)
    drawn = [make_sample(workpiece, poses, view, np.random.default_rng((7, i))) for i, poses in enumerate(held)]
    validation = [sample for sample in drawn if sample is not None]

    clouds = 0
    start = time.monotonic()
    samples = stream(workpiece, heaps, config.seed, before, config.loaders)
    source = batches(samples, config, np.random.default_rng((config.seed, before, 1)))
    sums: dict[str, float] = {}
    steps = summed = 0
    columns = [TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()]
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(f"{workpiece.name} on {device.type}", total=1.0)
        done = 0.0
        while done < 1.0:
            done = min(max(clouds / config.clouds, (time.monotonic() - start) / 60 / config.minutes), 1.0)
            warm = min(1.0, (steps + 1) / 200)
            for group in optimiser.param_groups:
                group["lr"] = config.learning_rate * warm * 0.5 * (1 + math.cos(math.pi * done))
            network.train()
            batch = next(source)
            keep, target = collate(batch, device)
            prediction = kept(network(pack([s.graph for s in batch], device)), keep)
            loss, parts = ps6d_loss(prediction, target, model)
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
            optimiser.step()
            mean.update(network)
            steps += 1
            clouds += len(batch)
            summed += 1
            for key, value in parts.items():
                sums[key] = sums.get(key, 0.0) + float(value)
            if clouds % config.validate_every < config.batch or done >= 1.0:
                scores = validate(mean.network, validation, model, device)
                seconds = seconds_before + time.monotonic() - start
                row = {"clouds": before + clouds, "seconds": seconds, **scores}
                row |= {f"train_{k}": v / summed for k, v in sums.items()}
                sums, summed = {}, 0
                history.append(row)
                (out / "history.jsonl").write_text("".join(json.dumps(r) + "\n" for r in history))
                _save(out, network, mean, history, before + clouds, seconds, workpiece, config)
                draw_curves(history, out / "curves.png", workpiece.name)
                console.print(
                    f"{before + clouds} clouds, {seconds / 60:.1f} min: centre {scores['centre']:.3f}, rotation "
                    f"{scores['rotation']:.3f} units, voting points right {100 * scores['right']:.1f} %"
                )
            shown = f"{workpiece.name} {before + clouds} clouds, loss {loss.item():.3f}"
            bar.update(task, completed=done, description=shown)
    source.close()  # type: ignore[attr-defined]
    samples.close()  # type: ignore[attr-defined]
    return out / "ps6d.safetensors"


def _save(
    out: Path, network: Ps6d, mean: Mean, history: list[dict[str, float]], clouds: int, seconds: float,
    workpiece: Workpiece, config: TrainConfig,
) -> None:  # fmt: skip
    state = {"network": mean.network.state_dict(), "history": history, "clouds": clouds, "seconds": seconds}
    part = out / "checkpoint.part"
    torch.save(state, part)
    part.replace(out / "checkpoint.pt")
    record: dict[str, object] = {
        "command": f"pickproof train {workpiece.name}",
        "clouds": clouds,
        "seconds": round(seconds),
        "device": next(network.parameters()).device.type,
        "config": asdict(config),
        "validation": history[-1],
        "torch": torch.__version__,
    }
    save_weights(out / "ps6d.safetensors", mean.network, workpiece, record)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `pickproof train`."""
    d = TrainConfig()
    parser.add_argument("workpiece")
    parser.add_argument("--minutes", type=float, default=d.minutes, help=f"stop after these (default {d.minutes:g})")
    parser.add_argument("--clouds", type=int, default=d.clouds, help="stop after this many clouds")
    parser.add_argument("--heaps", type=int, default=d.heaps, help=f"settled heaps to train on (default {d.heaps})")
    parser.add_argument("--batch", type=int, default=d.batch, help=f"clouds a step (default {d.batch})")
    parser.add_argument("--reuse", type=int, default=d.reuse, help="times a rendered cloud is used")
    parser.add_argument("--lr", type=float, default=d.learning_rate, help="peak learning rate")
    parser.add_argument("--loaders", type=int, default=d.loaders, help="rendering processes (0: in this one)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--plain", action="store_true", help="without local frames and CAD-coordinate head (ablation)")
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoint in the output folder")
    parser.add_argument("--out", type=Path, default=None, help="output folder (default out/train/WORKPIECE)")


def main_train(args: argparse.Namespace) -> int:
    """`pickproof train WORKPIECE`."""
    for name in ("minutes", "clouds", "heaps", "batch", "reuse", "lr"):
        if not getattr(args, name) > 0:
            raise InputError("command line", f"--{name}", getattr(args, name), "a number above 0")
    if args.loaders < 0 or args.seed < 0:
        raise InputError("command line", "--loaders, --seed", (args.loaders, args.seed), "0 or more")
    workpiece = load_workpiece(args.workpiece)
    config = TrainConfig(
        minutes=args.minutes, clouds=args.clouds, heaps=args.heaps, batch=args.batch, reuse=args.reuse,
        learning_rate=args.lr, loaders=args.loaders, seed=args.seed,
        network=NetworkConfig(local_frames=not args.plain, cad_head=not args.plain),
    )  # fmt: skip
    out = args.out or Path("out") / "train" / workpiece.name
    console = Console()
    path = train(workpiece, config, out, args.resume, console)
    console.print(f"weights: {path}\ncurves:  {out / 'curves.png'}")
    return 0
