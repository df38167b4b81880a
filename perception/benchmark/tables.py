"""The tables of a benchmark, for the terminal and as markdown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

FIGURES = ("f1_inst", "recall", "precision", "ap_sileane", "ap_mssd", "seconds_per_frame", "frames")
MEANS = FIGURES[:-1]
HEADS = ("F1_inst", "Recall", "Prec.", "AP Sil.", "AP MSSD", "s/frame", "frames")
TITLES = {"methods": "Table I: methods", "ablations": "Table II: ablations"}

WIDTH = 96
"""Characters of the widest table."""

Rows = dict[str, dict[str, dict[str, Any]]]
"""Figures by workpiece and row."""


def mean_rows(rows: Rows) -> dict[str, dict[str, float]]:
    """Means over the workpieces that have a row, and their number."""
    names = dict.fromkeys(name for of_one in rows.values() for name in of_one)
    means: dict[str, dict[str, float]] = {}
    for name in names:
        have = [of_one[name] for of_one in rows.values() if name in of_one]
        means[name] = {f: float(np.mean([row[f] for row in have])) for f in MEANS} | {"workpieces": len(have)}
    return means


def table_cells(rows: Rows) -> list[list[str]]:
    """Cells of a table: a row for each workpiece and method, then the means."""
    cells = [
        [workpiece, name, *(_number(f, row[f]) for f in FIGURES)]
        for workpiece, of_one in rows.items()
        for name, row in of_one.items()
    ]
    means = mean_rows(rows).items()
    return cells + [
        [f"mean of {row['workpieces']}", name, *(_number(f, row[f]) for f in MEANS), ""] for name, row in means
    ]


def stage_cells(stages: dict[str, dict[str, Any]]) -> list[list[str]]:
    """Cells of the table of stages: workpiece, stage, milliseconds."""
    cells = []
    for workpiece, of_one in stages.items():
        about = f"{workpiece}, {of_one['parts']:.1f} parts, mean of {of_one['frames']}"
        cells += [[about, stage, f"{1000 * s:.1f}"] for stage, s in of_one["seconds"].items()]
        if (forward := of_one["forward"]) is not None:
            about = f"{workpiece}, {forward['input_points']} input points, {forward['voting_points']} voting points"
            cells.append(
                [
                    about,
                    f"forward pass alone, median of {forward['repeats']}",
                    f"{1000 * forward['median_seconds']:.1f}",
                ]
            )
    return cells


def tables(data: dict[str, Any]) -> list[tuple[str, Sequence[str], list[list[str]]]]:
    """Title, heads and cells of every table that has rows."""
    methods = {name: of_one["methods"] for name, of_one in data["workpieces"].items()}
    found = [
        (TITLES["methods"], ("workpiece", "method", *HEADS), table_cells(methods)),
        (TITLES["ablations"], ("workpiece", "ablation", *HEADS), table_cells(data["ablations"])),
        ("Stages on one core", ("workpiece", "stage", "ms"), stage_cells(data["stages"])),
    ]
    return [table for table in found if table[2]]


def missing_lines(data: dict[str, Any]) -> list[str]:
    """One line for each file of weights that is missing."""
    return [
        f"{m['workpiece']}: no {', '.join(m['rows'])}: {m['file']} is missing; `{m['command']}` trains it, and "
        f"{m['trained']} is to be copied there"
        for m in data["missing"]
    ]


def markdown(data: dict[str, Any]) -> str:
    """All tables, with the command and what is missing."""
    noise = "with the sensor's noise" if data["noise"] else "without noise"
    parts = [f"`{data['command']}`", f"Held-out heaps {noise}; shares in per cent; one thread a frame."]
    for title, heads, cells in tables(data):
        rule = ["---" if i < 2 else "---:" for i in range(len(heads))]
        parts.append(f"## {title}")
        parts.append("\n".join(f"| {' | '.join(line)} |" for line in (heads, rule, *cells)))
    parts += missing_lines(data)
    return "\n\n".join(parts) + "\n"


def show(data: dict[str, Any]) -> None:
    """Print all tables, whole even where the terminal is narrow."""
    console = Console(width=max(Console().width, WIDTH))
    for title, heads, cells in tables(data):
        table = Table(title=title, title_justify="left", box=None, padding=(0, 1, 0, 0))
        for i, head in enumerate(heads):
            table.add_column(head, justify="left" if i < 2 else "right")
        for line in cells:
            table.add_row(*line)
        console.print(table)


def _number(figure: str, value: float) -> str:
    return f"{value:d}" if figure == "frames" else f"{value:.2f}"
