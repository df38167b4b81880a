"""Detects a campaign in which the physics failed in every attempt: it must not end with exit code 0."""

from __future__ import annotations

from pathlib import Path

from pickproof.cell.errors import PickproofError
from pickproof.scenarios.results.records import Reason
from pickproof.scenarios.results.store import LARGE_COLUMNS, Store


class NothingMeasuredError(PickproofError):
    """Every attempt of a campaign ended in `simulation_error`."""


def broken(directory: Path) -> str:
    """In one sentence that every attempt of a campaign ended in `simulation_error`; empty where one did not."""
    with Store.read(directory) as store:
        reasons = [a.reason for a in store.each_attempt(without=LARGE_COLUMNS)]
        if not reasons or set(reasons) != {Reason.SIMULATION_ERROR}:
            return ""
        tree = next(iter(store.each_attempt(without=("waypoints",)))).tree
    first = f"; the first: {tree['error']}" if isinstance(tree, dict) and "error" in tree else ""
    return f"{directory}: nothing was measured, every attempt ({len(reasons)}) ended in simulation_error{first}"


def check_ran(directory: Path) -> None:
    """Look at a campaign that has ended.

    Raises:
        NothingMeasuredError: every attempt ended in `simulation_error`.
    """
    if said := broken(directory):
        raise NothingMeasuredError(said)
