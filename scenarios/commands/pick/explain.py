"""`pickproof explain DIR --attempt N`: the decisions of one attempt."""

from __future__ import annotations

import json as json_module
from typing import Annotated

from pickproof.scenarios.commands.arguments import AttemptIndex, ResultsFolder, about


def explain(
    directory: ResultsFolder,
    /,
    *,
    attempt: AttemptIndex,
    all: Annotated[bool, about("show all estimates, not only the first ones")] = False,
    json: Annotated[bool, about("print the tree as JSON")] = False,
) -> int:
    """`pickproof explain DIR --attempt N`."""
    from rich.console import Console

    from pickproof.scenarios.reporting.explain import ESTIMATES_SHOWN
    from pickproof.scenarios.reporting.explain import explain as print_explanation
    from pickproof.scenarios.results.store import Store

    with Store.read(directory) as store:
        found = store.nth_attempt(attempt)
    if json:
        head = {"seed": found.seed, "attempt": found.attempt, "success": found.success, "reason": found.reason}
        print(json_module.dumps(head | {"grasp": found.grasp, "tree": found.tree}, indent=2))
    else:
        print_explanation(found, int(attempt), Console(), None if all else ESTIMATES_SHOWN)
    return 0
