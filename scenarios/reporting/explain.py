"""`pickproof explain DIR --attempt N`: why one attempt did what it did, from its tree of verdicts."""

from __future__ import annotations

from collections import Counter
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.tree import Tree

from pickproof.grasping.verdict import CHOSEN, MEANING, Verdict
from pickproof.scenarios.reporting.verdict_counts import verdict_counts
from pickproof.scenarios.results.records import MEANING as REASONS
from pickproof.scenarios.results.records import AttemptRecord

ESTIMATES_SHOWN = 12


def explain(attempt: AttemptRecord, index: int, console: Console, shown: int | None = ESTIMATES_SHOWN) -> None:
    """Print estimates -> grasp points -> verdicts of an attempt, what was chosen and what came of it."""
    console.print(_tree(attempt, index, shown))
    if isinstance(attempt.tree, list):
        console.print(_totals(verdict_counts(attempt.tree)))


def _tree(attempt: AttemptRecord, index: int, shown: int | None) -> Tree:
    where = f"seed {attempt.seed}, attempt {attempt.attempt}, {attempt.parts_in_bin_before} workpieces in the bin"
    root = Tree(f"[bold]attempt {index}[/bold]: {where}")
    estimates = attempt.tree if isinstance(attempt.tree, list) else []
    mine = [k for k, e in enumerate(estimates) if CHOSEN in verdict_counts(e)]
    order = mine + sorted((k for k in range(len(estimates)) if k not in mine), key=lambda k: _best(estimates[k]))
    for k in order[:shown]:
        _add_estimate(root, k, estimates[k])
    if shown is not None and len(order) > shown:
        root.add(f"{len(order) - shown} more estimates: --all shows them")
    if not estimates:
        root.add(str(attempt.tree["error"]) if isinstance(attempt.tree, dict) else "no estimates")
    root.add(_outcome(attempt))
    return root


def _best(estimate: dict[str, Any]) -> float:
    """Sort key: estimates with the best candidate first, those without any by score."""
    ranks = [c["rank"] for c in estimate.get("candidates", ())]
    return -max(ranks) if ranks else 1.0 - float(estimate.get("score", 0.0))


def _add_estimate(root: Tree, k: int, estimate: dict[str, Any]) -> None:
    at = ", ".join(f"{1000 * x:.0f}" for x in estimate.get("position", ()))
    node = root.add(f"estimate {k}: score {estimate.get('score', 0.0):.2f} at ({at}) mm")
    for candidate in estimate.get("candidates", ()):
        terms = " + ".join(f"{name} {value:.2f}" for name, value in candidate["terms"].items())
        style = "green" if candidate["verdict"] == CHOSEN else "yellow"
        line = f"[{style}]{escape(candidate['grasp'])}: {candidate['verdict']}[/{style}], rank {candidate['rank']:.2f}"
        detail = candidate.get("detail")
        leaf = node.add(line + (f" ({escape(detail)})" if detail else ""))
        if candidate["verdict"] == CHOSEN:
            leaf.add(f"terms before weights: {terms}")
            if "weighed" in candidate:
                leaf.add(f"workpieces by weight: {candidate['weighed']}")
    alike: dict[str, list[str]] = {}
    for name, counts in estimate.get("ruled_out", {}).items():
        if len(counts) > 1:
            node.add(f"{escape(name)}: " + ", ".join(f"{n} {verdict}" for verdict, n in sorted(counts.items())))
        for verdict, n in counts.items() if len(counts) == 1 else ():
            alike.setdefault(verdict, []).append(f"{escape(name)} {n}")
    for verdict, names in alike.items():
        node.add(f"[dim]{verdict} alone: {', '.join(names)}[/dim]")


def _outcome(attempt: AttemptRecord) -> str:
    if attempt.success:
        at = (
            ""
            if attempt.place_mm is None
            else f", {attempt.place_mm:.1f} mm and {attempt.place_deg:.0f} deg off its place"
        )
        return f"[green]success[/green] with {attempt.grasp}{at}"
    said = REASONS[attempt.reason] if attempt.reason else ""
    moved = f"with {attempt.grasp}" if attempt.moved else "the arm did not move"
    return f"[red]{attempt.reason}[/red], {moved}: {said}"


def _totals(counts: Counter[str]) -> Table:
    table = Table(title="grasp poses by verdict", title_justify="left")
    table.add_column("verdict")
    table.add_column("poses", justify="right")
    table.add_column("what it means")
    for verdict in [CHOSEN, *Verdict]:
        if counts[verdict]:
            table.add_row(
                str(verdict), str(counts[verdict]), "picked" if verdict == CHOSEN else MEANING[Verdict(verdict)]
            )
    return table
