"""`pickproof fit-score WORKPIECE`: calibrates the score of a workpiece's poses on validation heaps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.arguments import Workers, WorkpieceName, about, integer
from pickproof.scenarios.commands.invocation import command_line

if TYPE_CHECKING:
    from rich.console import Console


def fit_score(
    workpiece: WorkpieceName,
    /,
    *,
    frames: Annotated[int, integer(2, 1_000_000), about("validation heaps")] = 40,
    weights: Annotated[Path | None, about("weights to calibrate; default: the shipped ones")] = None,
    workers: Workers = 1,
    out: Annotated[Path | None, about("output file; default: score.json in the workpiece's folder")] = None,
) -> int:
    """`pickproof fit-score WORKPIECE`; 3 where the examples are too few or the fit is no better than the default."""
    from rich.console import Console

    from pickproof.cell.workpiece.workpiece import load_workpiece
    from pickproof.perception.evaluation.fit_score import fit_score as fit_on_heaps
    from pickproof.perception.ps6d.weights import file_hash, weights_path
    from pickproof.perception.refinement.score_model import score_path

    part = load_workpiece(workpiece)
    file = out or score_path(part)
    if not file.parent.is_dir() or (file.exists() and not file.is_file()):
        raise InputError("command line", "--out", str(file), "a regular file in a folder that exists")
    console = Console()
    result = fit_on_heaps(part, frames, weights, workers, console)
    console.print(
        f"{part.name}: {result.record['right']} right and {result.record['wrong']} wrong poses examined in "
        f"{frames} validation heaps; without a better rival {result.record['standing_right']} right and "
        f"{result.record['standing_wrong']} wrong"
    )
    _print_half(console, result.record.get("unfitted_half"))
    if result.model is None:
        console.print(f"nothing written, the default score is kept: {result.reason}")
        return 3
    source = {"command": command_line(), "weights": file_hash(weights or weights_path(part)), "frames": frames}
    result.model.save(file, source | result.record)
    console.print(f"wrote {file}", soft_wrap=True)
    return 0


def _print_half(console: Console, half: object) -> None:
    if isinstance(half, dict):
        console.print(
            f"unrivalled poses of the frames that were not fitted, {half['right']} of {half['standing']} right: "
            f"expected calibration error "
            f"{half['ece_before']:.4f} before, {half['ece_after']:.4f} after; "
            f"Brier score {half['brier_before']:.4f} before, {half['brier_after']:.4f} after"
        )
