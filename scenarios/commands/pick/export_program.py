"""`pickproof export-program DIR --attempt N`: the motion of one attempt as a Fanuc TP program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pickproof.scenarios.commands.arguments import FILE_TO_WRITE, AttemptIndex, ResultsFolder, about, integer


def export_program(
    directory: ResultsFolder,
    /,
    *,
    attempt: AttemptIndex,
    name: Annotated[str, about("of the program; default: PICK_N")] = "",
    output: Annotated[int, integer(1, 999), about("number of the robot output that closes the gripper, RO[N]")] = 1,
    out: Annotated[Path | None, FILE_TO_WRITE, about("default: DIR/NAME.LS")] = None,
) -> int:
    """`pickproof export-program DIR --attempt N`."""
    from pickproof.cell.errors import InputError
    from pickproof.scenarios.reporting.tp_export import program_of

    name, text = program_of(directory, attempt, name, output)
    path = out or directory / f"{name}.LS"
    try:
        path.write_text(text, encoding="ascii")
    except OSError as error:
        raise InputError("command line", "--out", str(path), f"a file that can be written ({error.strerror})") from None
    print(f"wrote {path}")
    return 0
