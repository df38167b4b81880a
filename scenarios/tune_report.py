"""What `pickproof tune` found: in the terminal, as JSON, and as one self-contained page that fetches nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from rich.console import Console
from rich.table import Table

from cell.page import page_template
from grasping.grasp_points import GraspPoint
from scenarios.compare import points as in_points
from scenarios.compare import span, verdict_line
from scenarios.files import write_whole
from scenarios.report_figures import BAD, BLUE, GOOD, IDLE, LAYOUT, as_json, library
from scenarios.summary import percent
from scenarios.tune_cell import CELL
from scenarios.tune_plan import Plan
from scenarios.tune_run import Result
from scenarios.tune_search import Trial

REPORT = "tune.html"
SHOWN = 12  # parameters of a search in the figure of importance


def document(result: Result) -> dict[str, Any]:
    """What tune.json holds."""
    return {
        "grasps": [asdict(g) for g in result.grasps],
        "fields": result.fields,
        "history": {name: [asdict(t) for t in trials] for name, trials in result.history.items()},
        "importances": result.importances,
        "comparison": asdict(result.comparison) if result.comparison else None,
    }


def print_grasps(console: Console, result: Result) -> None:
    """Before and after of each grasp."""
    if not result.grasps:
        return
    table = Table(title="held on a lone workpiece under errors that the search had not seen", title_justify="left")
    for column in ("grasp point", "before", "after", "moved", "what failed before"):
        table.add_column(column, justify="right" if column in ("before", "after") else "left", no_wrap=True)
    for g in result.grasps:
        table.add_row(g.name, percent(g.share[0], 0), percent(g.share[1], 0), "yes" if g.changed else "", g.reason[0])
    console.print(table)


def changes(before: Sequence[GraspPoint], after: Sequence[GraspPoint]) -> dict[str, list[tuple[str, str, str]]]:
    """Name of a grasp point -> (field, before, after) of what differs."""
    found: dict[str, list[tuple[str, str, str]]] = {}
    for old, new in zip(before, after, strict=True):
        a, b = old.model_dump(mode="json"), new.model_dump(mode="json")
        rows = [(name, str(a[name]), str(b[name])) for name in a if a[name] != b[name]]
        if rows:
            found[old.name] = rows
    return found


def write_tune_report(plan: Plan, result: Result, path: Path) -> Path:
    """Write the page.

    Raises:
        StoreError: it cannot be written.
    """
    figures = {}
    grasps = {name: trials for name, trials in result.history.items() if name != CELL and trials}
    if grasps:
        figures["grasps"] = as_json(_best_so_far(grasps))
    if result.history.get(CELL):
        figures["cells"] = as_json(_cells(result.history[CELL]))
    known = {name: shares for name, shares in result.importances.items() if shares}
    for i, (name, shares) in enumerate(known.items()):
        figures[f"importance-{i}"] = as_json(_importance(shares, name))
    template = page_template("scenarios", "tune.html.j2", percent=percent)
    page = template.render(
        plan=plan,
        result=result,
        changes=changes(plan.points, result.points),
        fields=[(name, _field(plan, name), value) for name, value in result.fields.items()],
        figures=figures,
        importances=[f for f in figures if f.startswith("importance")],
        verdict=verdict_line(result.comparison) if result.comparison else "",
        rows=_rows(result),
        plotly=library() if figures else "",
        trials=sum(len(t) for t in result.history.values()),
    )
    return write_whole(path, page)


def _field(plan: Plan, name: str) -> Any:
    value: Any = plan.scenario.model_dump(mode="json")
    for key in name.split("."):
        value = value[int(key) if isinstance(value, list) else key]
    return value


def _rows(result: Result) -> list[tuple[str, str, str, str, str]]:
    c = result.comparison
    if c is None:
        return []
    named = [("pick success", c.success), ("clearance", c.clearance), ("first attempts", c.first_attempts)]
    named += list(c.reasons.items())
    return [
        (name.replace("_", " "), percent(d.a), percent(d.b), in_points(d.difference), span(d.interval95))
        for name, d in named
        if d is not None
    ]


def _best_so_far(grasps: dict[str, list[Trial]]) -> go.Figure:
    figure = go.Figure()
    for name, trials in grasps.items():
        best = np.maximum.accumulate([t.value for t in trials])
        figure.add_scatter(
            x=list(range(1, len(trials) + 1)),
            y=best.tolist(),
            mode="lines",
            line_shape="hv",
            name=name,
            customdata=[t.value for t in trials],
            hovertemplate=name + ": best %{y:.2f}, this one %{customdata:.2f}<extra></extra>",
        )
    figure.update_layout(**(LAYOUT | {"showlegend": True}), height=360)
    figure.update_xaxes(title_text="trial of the grasp")
    figure.update_yaxes(title_text="best value so far")
    return figure


def _cells(trials: Sequence[Trial]) -> go.Figure:
    gains = [100 * t.detail["gain"] for t in trials]
    low, high = ([abs(100 * t.detail["interval95"][k] - g) for t, g in zip(trials, gains, strict=True)] for k in (0, 1))
    best = max(range(len(trials)), key=lambda i: (trials[i].value, -i))
    figure = go.Figure(
        go.Scatter(
            x=list(range(1, len(trials) + 1)),
            y=gains,
            error_y={"type": "data", "array": high, "arrayminus": low, "symmetric": False, "color": "#9db4cc"},
            mode="markers",
            marker={
                "size": [5 + 1.2 * t.detail["episodes"] ** 0.8 for t in trials],
                "color": [GOOD if i == best else (BAD if t.detail["dropped"] else BLUE) for i, t in enumerate(trials)],
            },
            customdata=[[t.detail["episodes"], 100 * t.detail["rate"]] for t in trials],
            hovertemplate="%{y:+.1f} points in %{customdata[0]} bins, %{customdata[1]:.1f} %<extra></extra>",
        )
    )
    figure.add_hline(y=0, line_color=IDLE, line_width=1)
    figure.update_layout(**LAYOUT, height=340)
    figure.update_xaxes(title_text="candidate")
    figure.update_yaxes(title_text="gain over the start in the same bins, points")
    return figure


def _importance(shares: dict[str, float], name: str) -> go.Figure:
    top = sorted(shares.items(), key=lambda item: item[1])[-SHOWN:]
    figure = go.Figure(go.Bar(x=[v for _, v in top], y=[k for k, _ in top], orientation="h", marker_color=BLUE))
    figure.update_layout(**LAYOUT, height=90 + 22 * len(top), title={"text": name, "font": {"size": 13}})
    figure.update_xaxes(range=[0, 1])
    figure.update_yaxes(automargin=True)
    return figure
