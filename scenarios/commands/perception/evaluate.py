"""`pickproof evaluate WORKPIECE`: the paper's metrics over held-out seeded heaps, before and after refinement."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.arguments import Flat, Workers, WorkpieceName, about, integer
from pickproof.scenarios.commands.invocation import command_line
from pickproof.scenarios.commands.perception.arguments import MethodName, NoiseOptions, SourceOptions
from pickproof.scenarios.config.seeds import MAX_SEED

if TYPE_CHECKING:
    from rich.console import Console

    from pickproof.cell.workpiece.workpiece import Workpiece


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(SourceOptions, NoiseOptions):
    """Options of `pickproof evaluate`."""

    frames: Annotated[
        int | None, integer(1, 1_000_000), about("number of heaps; default: 50 held-out ones, or all given ones")
    ] = None
    seed: Annotated[int, integer(0, MAX_SEED), about("added to the first held-out seed")] = 0
    bop_results: Annotated[Path | None, about("write the poses found in --bop to this file as BOP's CSV")] = None
    weights: Annotated[Path | None, about("weights to evaluate; default: the shipped ones")] = None
    method: MethodName = "auto"
    workers: Workers = 1
    json: Annotated[bool, about("print the evaluation as JSON; progress goes to stderr")] = False
    out: Annotated[Path | None, about("output folder; default: out/evaluate/WORKPIECE")] = None


def evaluate(
    workpiece: WorkpieceName,
    /,
    *,
    options: Annotated[EvaluateOptions, Flat] = EvaluateOptions(),
) -> int:
    """`pickproof evaluate WORKPIECE`."""
    from rich.console import Console

    from pickproof.perception.evaluation.evaluate import EvaluationRequest
    from pickproof.perception.evaluation.evaluate import evaluate as evaluate_network

    if options.bop is not None and (options.sensor or options.no_noise):
        option, value = ("--sensor", options.sensor) if options.sensor else ("--no-noise", "given")
        raise InputError("command line", option, value, "no sensor option with --bop: its images are measured")
    if options.bop_results is not None and options.bop is None:
        raise InputError("command line", "--bop-results", str(options.bop_results), "to stand beside --bop DIR")
    asked = EvaluationRequest(
        workpiece,
        options.frames,
        options.seed,
        options.source(),
        options.bop_results,
        options.weights,
        options.sensor_config(),
        options.workers,
        options.out,
        command_line(),
        options.method,
    )
    console = Console(stderr=options.json)
    found, out = evaluate_network(asked, console)
    if options.json:
        print(json.dumps(found.data, indent=1))
        return 0
    _print(console, found.workpiece, found.data)
    if options.bop_results is not None:
        console.print(f"wrote {options.bop_results}", soft_wrap=True)
    console.print(f"wrote evaluation.html, .json, .png and instances.csv to {out}", soft_wrap=True)
    return 0


def _print(console: Console, workpiece: Workpiece, data: dict[str, Any]) -> None:
    from rich.table import Table

    table = Table(title=f"{workpiece.name}: {data['scenes']}, T_e = {data['tolerance_mm']:g} mm")
    columns = ("f1_inst", "recall", "precision", "median_mm", "median_deg")
    for column in ("method", *columns, "s/frame"):
        head = column.replace("median_", "median\n")
        table.add_column(head, justify="left" if column == "method" else "right", no_wrap=column == "method")
    for name, m in data["methods"].items():
        cells = ["-" if m[c] is None else f"{m[c]:.2f}" for c in columns]
        table.add_row(name, *cells, f"{m['seconds_per_frame']['total']:.2f}")
    console.print(table)
    split = data["methods"][data["shown"]]["seconds_per_frame"]
    console.print("seconds per frame: " + ", ".join(f"{k} {v:.3f}" for k, v in split.items()))
    console.print(f"expected calibration error {data['calibration']['ece']:.3f}")
