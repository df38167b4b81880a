"""`pickproof benchmark gate`: the error rates of the gate and the coverage of the intervals."""

from __future__ import annotations

from typing import Annotated

from pickproof.scenarios.commands.arguments import JsonFile, about, integer
from pickproof.scenarios.config.seeds import MAX_SEED


def gate(
    *,
    campaigns: Annotated[int, integer(10, 1_000_000), about("simulated gates")] = 10_000,
    seed: Annotated[int, integer(0, MAX_SEED), about("seed of the simulation")] = 0,
    json: JsonFile = None,
) -> int:
    """`pickproof benchmark gate`."""
    from rich.console import Console

    from pickproof.scenarios.comparison.gate_calibration import calibrate, print_tables
    from pickproof.scenarios.files.atomic import write_json

    found = calibrate(campaigns, seed)
    print_tables(Console(), found)
    if json:
        write_json(json, found)
    return 0
