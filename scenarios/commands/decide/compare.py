"""`pickproof compare A B`: two campaigns over the same bins."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from pickproof.scenarios.commands.arguments import FILE_TO_WRITE, SOME_PATH, about


def compare(
    a: Annotated[Path, SOME_PATH, about("folder of a campaign")],
    b: Annotated[Path, SOME_PATH, about("folder of another campaign over the same bins")],
    /,
    *,
    json: Annotated[Path | None, FILE_TO_WRITE, about("write the comparison to this file as JSON")] = None,
) -> int:
    """`pickproof compare A B`."""
    from rich.console import Console

    from pickproof.scenarios.comparison.compare import compare as compare_campaigns
    from pickproof.scenarios.comparison.compare_text import print_comparison
    from pickproof.scenarios.files.atomic import write_json

    comparison = compare_campaigns(a, b)
    if json:
        write_json(json, {"a": str(a), "b": str(b), **asdict(comparison)})
    print_comparison(Console(), comparison, a, b)
    return 0
