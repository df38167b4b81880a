"""`pickproof train WORKPIECE`: PS6D for one workpiece from streamed scenes, resumable, on the CPU or on CUDA."""

from __future__ import annotations

import os
import shlex
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

from pickproof.scenarios.commands.arguments import Flat, WorkpieceName, about, integer, number
from pickproof.scenarios.commands.perception.arguments import SourceOptions
from pickproof.scenarios.config.seeds import MAX_SEED


@dataclass(frozen=True, kw_only=True)
class TrainOptions(SourceOptions):
    """Options of `pickproof train`; the defaults are those of `TrainConfig`, which a test holds equal. The upper
    limits refuse typing errors and values that exceed the memory."""

    minutes: Annotated[float, number(0, 1e6, above=True), about("stop after this time")] = 60.0
    clouds: Annotated[int, integer(1, 10**9), about("stop after this many clouds")] = 200_000
    heaps: Annotated[int, integer(1, 10**6), about("settled heaps to train on")] = 320
    batch: Annotated[int, integer(1, 4096), about("clouds per step; more on CUDA")] = 4
    reuse: Annotated[int, integer(1, 10**6), about("number of uses of a rendered cloud")] = 4
    lr: Annotated[float, number(0, 1, above=True), about("peak learning rate")] = 3e-3
    loaders: Annotated[
        int, integer(0, 256), about("rendering processes; 0: in this one; on CUDA: all cores but one")
    ] = 1
    seed: Annotated[int, integer(0, MAX_SEED), about("seed of scenes and weights")] = 0
    variant: Annotated[
        str,
        about("network: ps6d, no_local_frames, no_cad_head, plain, pointnet2_msg, no_normalisation or ppr_net_pp"),
    ] = "ps6d"
    init: Annotated[str, about("start from weights of the same variant: a workpiece's name or a file")] = ""
    resume: Annotated[bool, about("continue from the checkpoint in the output folder")] = False
    out: Annotated[Path | None, about("output folder; default: out/train/WORKPIECE[-VARIANT]")] = None


def train(
    workpiece: WorkpieceName,
    /,
    *,
    options: Annotated[TrainOptions, Flat] = TrainOptions(),
) -> int:
    """`pickproof train WORKPIECE`."""
    from rich.console import Console

    from pickproof.cell.numerics import fast_training
    from pickproof.cell.workpiece.workpiece import load_workpiece
    from pickproof.perception.ps6d.variants import network_config
    from pickproof.perception.training.train import init_path, put_to_use, weights_of
    from pickproof.perception.training.train import train as train_network
    from pickproof.perception.training.trainer import TrainConfig

    part = load_workpiece(workpiece)
    network = network_config(options.variant, part)
    given = options.source().scenes(part, os.cpu_count() or 1)
    config = TrainConfig(
        minutes=options.minutes,
        clouds=options.clouds,
        heaps=len(given) if given else options.heaps,
        batch=options.batch,
        reuse=options.reuse,
        learning_rate=options.lr,
        loaders=options.loaders,
        seed=options.seed,
        init=str(init_path(options.init, options.variant)) if options.init else "",
        network=network,
    )
    suffix = f"-{options.variant}" if options.variant != "ps6d" else ""
    out = options.out or Path("out") / "train" / (part.name + suffix)
    console = Console()
    with fast_training():
        path = train_network(part, config, out, options.resume, console, shortest(workpiece, options), given)
    console.print(f"weights: {path}\ncurves:  {out / 'curves.png'}")
    console.print(put_to_use(path, weights_of(part, options.variant)), soft_wrap=True)
    return 0


def shortest(workpiece: str, options: TrainOptions) -> str:
    """The command that gives these options, defaults and the output folder left out."""
    words = ["pickproof", "train", workpiece]
    for field in fields(options):
        value = getattr(options, field.name)
        if value != field.default and field.name != "out":
            option = f"--{field.name.replace('_', '-')}"
            words += [option] if value is True else [option, str(value)]
    return shlex.join(words)
