"""The folder of a tuning run: which search it holds, what it proposes, and how the proposal is taken over."""

from __future__ import annotations

import hashlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pickproof.cell.errors import InputError
from pickproof.scenarios.config.scenario import scenario_json, scenario_path
from pickproof.scenarios.files.atomic import write_json, write_whole
from pickproof.scenarios.tuning.optimizer import JOURNAL
from pickproof.scenarios.tuning.plan import Plan
from pickproof.scenarios.tuning.proposal import (
    SCENARIO,
    TABLE,
    accept,
    changed_scenario,
    changed_table,
    read_proposal,
)
from pickproof.scenarios.tuning.report import REPORT, document, write_tune_report
from pickproof.scenarios.tuning.request import TuneRequest, fixed_scenario, table_of
from pickproof.scenarios.tuning.run import Result

STATE, RESULT = "plan.json", "tune.json"


def claim(plan: Plan, resume: bool) -> None:
    """Note in the folder what is searched, or compare it with what was.

    Raises:
        InputError: there is another search, or one that `resume` does not ask for.
    """
    now = _identity(plan)
    there = plan.out / STATE
    if not resume:
        if (plan.out / JOURNAL).exists():
            raise InputError("command line", "--out", str(plan.out), "a folder without a search, or --resume")
        write_json(there, now)
        return
    before = read_proposal(there)
    different = sorted(k for k in now.keys() | before.keys() if now.get(k) != before.get(k))
    if different:
        raise InputError("command line", f"--resume {plan.out}", f"changed: {', '.join(different)}", "the same search")


def _identity(plan: Plan) -> dict[str, Any]:
    """What a search must have in common with one that it continues; more generations or bins are no other search."""
    return {
        "scenario": hashlib.sha256(scenario_json(plan.scenario).encode()).hexdigest(),
        "table": hashlib.sha256(plan.table.read_bytes()).hexdigest(),
        "grasps": list(plan.names),
        "fields": [asdict(f) for f in plan.fields],
        "oracle": sorted(plan.oracle),
        "reach": asdict(plan.reach),
        "errors": plan.p95,
        "block": plan.block,
        "episodes": plan.episodes,
    }


def write_proposal(plan: Plan, result: Result, source: Path, texts: dict[Path, str]) -> Path:
    """Write the changed table and scenario, the result and the page; returns the page.

    Args:
        source: file of the scenario.
        texts: of the table and of the scenario when the search began.
    """
    write_whole(plan.out / TABLE, changed_table(plan.table, plan.points, result.points, texts[plan.table]))
    write_whole(plan.out / SCENARIO, changed_scenario(source, result.fields, TABLE, texts[source]))
    write_json(plan.out / RESULT, document(result) | {"scenario_file": _digest(texts[source])})
    return write_tune_report(plan, result, plan.out / REPORT)


def accept_proposal(asked: TuneRequest, out: Path) -> tuple[str, list[Path]]:
    """Write what `out` proposes over table and scenario.

    Returns:
        What the unseen bins say about it, empty where it is better; and the files that were written.

    Raises:
        InputError: table or scenario have changed since the search.
    """
    table, source = table_of(fixed_scenario(asked)), scenario_path(asked.scenario)
    result, before = read_proposal(out / RESULT), read_proposal(out / STATE)
    if hashlib.sha256(table.read_bytes()).hexdigest() != before["table"]:
        raise InputError(table, "", "changed since the search, or another table", "the one that the search began with")
    if result["fields"] and _digest(source.read_text(encoding="utf-8")) != result.get("scenario_file"):
        raise InputError(source, "", "changed since the search, or another scenario", "the one that was searched")
    comparison = result["comparison"]
    doubt = "" if comparison is None or comparison["verdict"] == "better" else str(comparison["verdict"])
    return doubt, accept(out, table, source, result["fields"])


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
