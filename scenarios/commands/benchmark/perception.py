"""`pickproof benchmark perception`: PS6D, its peers and its ablations on the same held-out heaps (Tables I and II)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

from pickproof.scenarios.commands.arguments import Flat, Workers, about, integer
from pickproof.scenarios.commands.invocation import command_line

Method = Literal["ppf", "ppr_net", "ppr_net_pp", "ps6d", "ps6d_fitted", "ps6d_refined", "search", "both"]
"""`perception.benchmark.methods.METHODS` as a type; a test holds them equal."""
METHODS: tuple[Method, ...] = get_args(Method)


@dataclass(frozen=True, kw_only=True)
class BenchmarkOptions:
    """Options of `pickproof benchmark perception`."""

    frames: Annotated[int, integer(1, 10_000), about("held-out heaps of each workpiece")] = 50
    ppf_frames: Annotated[int | None, integer(1, 10_000), about("heaps for PPF, which is slow; default: --frames")] = (
        None
    )
    methods: Annotated[tuple[Method, ...], about("rows of Table I", consume_multiple=True)] = METHODS
    ablations: Annotated[bool, about("Table II too (ps6d_23, ps6d_24, candlestick)")] = False
    stages: Annotated[bool, about("measure the time of each stage of perception on one core")] = False
    weights_folder: Annotated[
        Path | None, about("folder with NAME/ps6d.safetensors in place of the shipped weights")
    ] = None
    variants_folder: Annotated[
        Path | None,
        about("folder with NAME/VARIANT.safetensors, weights of peers and ablations; default: the shipped ones"),
    ] = None
    workers: Annotated[Workers, about("processes of one thread")] = 1
    out: Annotated[Path, about("output folder")] = Path("out") / "benchmark"
    resume: Annotated[bool, about("keep results in --out with the same settings")] = False
    json: Annotated[bool, about("print benchmark.json alone; the rest goes to stderr")] = False


def perception(
    workpieces: Annotated[tuple[str, ...], about("default: all")] = (),
    /,
    *,
    options: Annotated[BenchmarkOptions, Flat] = BenchmarkOptions(),
) -> int:
    """`pickproof benchmark perception WORKPIECE...`."""
    from rich.console import Console

    from pickproof.perception.benchmark.run import BenchmarkRequest, run_benchmark
    from pickproof.perception.benchmark.tables import show

    given = {name: value for name, value in vars(options).items() if name != "json"}
    asked = BenchmarkRequest(workpieces=workpieces, command=command_line(), **given)
    console = Console(stderr=True)
    try:
        results = run_benchmark(asked, console)
    except KeyboardInterrupt:
        again = "" if options.resume else " --resume"
        console.print(f"interrupted; finished workpieces are kept: {asked.command}{again}", soft_wrap=True)
        return 130
    if options.json:
        print(json.dumps(results.data(), indent=1))
    else:
        show(results.data())
        console.print(f"wrote {results.path} and {results.path.with_suffix('.md')}", soft_wrap=True)
    return 0
