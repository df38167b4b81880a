"""The report's figures, drawn by plotly in the page itself; the library is embedded once, nothing is fetched."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from pickproof.scenarios.reporting.tables import Share

BLUE, BAD, IDLE, GOOD, INK = "#2f6fb3", "#c2463a", "#b98a1d", "#1f8a5b", "#1b2430"
PARTS = {"sensing": "#7aa6d6", "perceive": "#e0a33c", "choose": "#c98a2b", "plan": "#a96f1e", "robot": BLUE}
LAYOUT: dict[str, Any] = {
    "font": {"family": "system-ui, 'Segoe UI', 'DejaVu Sans', sans-serif", "size": 13, "color": INK},
    "paper_bgcolor": "rgba(0,0,0,0)",
    "plot_bgcolor": "#f7f9fb",
    "margin": {"l": 52, "r": 16, "t": 34, "b": 48},
    "showlegend": False,
}


def library() -> str:
    """plotly.js, some 4.5 MB."""
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())


def as_json(figure: go.Figure) -> str:
    """A figure as JSON that may stand in a script of an HTML page."""
    return str(figure.to_json()).replace("</", "<\\/")


def pareto(reasons: Sequence[tuple[str, int, bool]]) -> go.Figure:
    """Failures and no-picks by reason, most frequent first, and their cumulated share.

    Args:
        reasons: (reason, count, whether it is a no-pick).
    """
    names, counts, idle = [r[0] for r in reasons], [r[1] for r in reasons], [r[2] for r in reasons]
    total = max(sum(counts), 1)
    figure = make_subplots(specs=[[{"secondary_y": True}]])
    colours = [IDLE if i else BAD for i in idle]
    figure.add_bar(x=[n.replace("_", " ") for n in names], y=counts, marker_color=colours, name="count")
    figure.add_scatter(
        x=[n.replace("_", " ") for n in names],
        y=(100 * np.cumsum(counts) / total).tolist(),
        mode="lines+markers",
        line_color=INK,
        name="cumulated, %",
        secondary_y=True,
    )
    figure.update_layout(**LAYOUT, height=320)
    figure.update_yaxes(title_text="count", secondary_y=False)
    figure.update_yaxes(
        title_text="cumulated, %", range=[0, 104], tickvals=[0, 25, 50, 75, 100], secondary_y=True, showgrid=False
    )
    return figure


def dependence(panels: Mapping[str, Sequence[Share]]) -> go.Figure:
    """Success with its Wilson interval over classes of a value, a panel for each value."""
    columns = 2
    rows = -(-len(panels) // columns)
    figure = make_subplots(rows, columns, subplot_titles=list(panels), vertical_spacing=0.2, horizontal_spacing=0.09)
    for i, shares in enumerate(panels.values()):
        rates = [100 * s.rate for s in shares]
        low, high = ([abs(100 * s.bounds[k] - r) for s, r in zip(shares, rates, strict=True)] for k in (0, 1))
        figure.add_scatter(
            x=[s.label for s in shares],
            y=rates,
            error_y={"type": "data", "array": high, "arrayminus": low, "symmetric": False, "color": "#9db4cc"},
            mode="markers",
            marker={"size": 9, "color": BLUE},
            customdata=[[s.good, s.n] for s in shares],
            hovertemplate="%{x}: %{y:.1f} % (%{customdata[0]} of %{customdata[1]})<extra></extra>",
            row=i // columns + 1,
            col=i % columns + 1,
        )
    figure.update_layout(**LAYOUT, height=270 * rows)
    figure.update_yaxes(range=[-4, 105], title_text="success, %")
    figure.update_xaxes(type="category")
    return figure


def heat_map(good: np.ndarray, tried: np.ndarray, inner: Sequence[float]) -> go.Figure:
    """Success by where in the bin the chosen workpiece lay, seen from above; cells without an attempt stay empty."""
    ny, nx = tried.shape
    with np.errstate(invalid="ignore"):
        rate = np.where(tried > 0, 100 * good / np.maximum(tried, 1), np.nan)
    x = 1000 * inner[0] * ((np.arange(nx) + 0.5) / nx - 0.5)
    y = 1000 * inner[1] * ((np.arange(ny) + 0.5) / ny - 0.5)
    text = [[f"{g}/{n}" if n else "" for g, n in zip(*rows, strict=True)] for rows in zip(good, tried, strict=True)]
    figure = go.Figure(
        go.Heatmap(
            x=np.round(x, 1).tolist(),
            y=np.round(y, 1).tolist(),
            z=[[None if np.isnan(v) else float(v) for v in row] for row in rate],
            text=text,
            texttemplate="%{text}",
            hovertemplate="x %{x} mm, y %{y} mm: %{z:.1f} % (%{text})<extra></extra>",
            zmin=0,
            zmax=100,
            colorscale=[[0, BAD], [0.5, "#f0d9a8"], [1, GOOD]],
            colorbar={"title": "%"},
            xgap=2,
            ygap=2,
        )
    )
    figure.update_layout(**LAYOUT, height=340)
    figure.update_xaxes(title_text="x in the bin [mm]")
    figure.update_yaxes(title_text="y in the bin [mm]", scaleanchor="x")
    return figure


def cycle(parts: Sequence[Mapping[str, Any]]) -> go.Figure:
    """Where the time of a cycle goes: means stacked, with median and 95 % quantile on hovering."""
    figure = go.Figure()
    for part in parts:
        figure.add_bar(
            y=["cycle"],
            x=[part["mean"]],
            name=part["name"],
            orientation="h",
            marker_color=PARTS[part["name"]],
            hovertemplate=f"{part['name']}: mean {part['mean']:.2f} s, median {part['median']:.2f} s, "
            f"95 % under {part['high']:.2f} s<extra></extra>",
        )
    figure.update_layout(**(LAYOUT | {"showlegend": True}), barmode="stack", height=170)
    figure.update_layout(legend={"orientation": "h", "y": 1.5, "traceorder": "normal"})
    figure.update_xaxes(title_text="[s]")
    figure.update_yaxes(visible=False)
    return figure


def trend(labels: Sequence[str], rates: Sequence[float | None], bounds: Sequence[Sequence[float]]) -> go.Figure:
    """The rate of many runs with its interval, in the order given."""
    points = [None if r is None else 100 * r for r in rates]
    low, high = (
        [0.0 if r is None else abs(100 * b[k] - r) for r, b in zip(points, bounds, strict=True)] for k in (0, 1)
    )
    figure = go.Figure(
        go.Scatter(
            x=list(range(len(labels))),
            y=points,
            error_y={"type": "data", "array": high, "arrayminus": low, "symmetric": False, "color": "#9db4cc"},
            mode="lines+markers",
            marker={"size": 9, "color": BLUE},
            line={"color": "#bcd3ea"},
            text=list(labels),
            hovertemplate="%{text}: %{y:.1f} %<extra></extra>",
        )
    )
    figure.update_layout(**LAYOUT, height=320)
    figure.update_xaxes(tickvals=list(range(len(labels))), ticktext=list(labels))
    figure.update_yaxes(title_text="pick success, %", range=[-4, 105])
    return figure
