"""The report's charts, drawn by plotly in the page itself; the library is embedded once, nothing is fetched.

`report._figures` says which charts there are and of what; `trend` is of the index page. Bars within tables are HTML, in
`templates/report.html.j2`.
"""

from __future__ import annotations

import itertools
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


def _titled(text: str) -> dict[str, Any]:
    return {"title": {"text": text, "x": 0.5, "font": {"size": 14}}}


def pareto(reasons: Sequence[tuple[str, int, bool]]) -> go.Figure:
    """Failures and no-picks by reason, most frequent first, and their cumulated share.

    Args:
        reasons: (reason, count, whether it is a no-pick), two or more.
    """
    names = [reason.replace("_", " ") for reason, _, _ in reasons]
    counts = [n for _, n, _ in reasons]
    share = (100 * np.cumsum(counts) / max(sum(counts), 1)).tolist()
    figure = make_subplots(specs=[[{"secondary_y": True}]])
    figure.add_bar(x=names, y=counts, marker_color=[IDLE if i else BAD for _, _, i in reasons], name="count")
    line: dict[str, Any] = {"mode": "lines+markers", "line_color": INK, "name": "cumulated, %"}
    figure.add_scatter(x=names, y=share, secondary_y=True, **line)
    figure.update_layout(**LAYOUT, **_titled("failures and no-picks"), height=320)
    step = max(1, -(-max(counts) // 5))  # whole numbers alone
    figure.update_yaxes(title_text="count", dtick=step, tickformat="d", rangemode="tozero", secondary_y=False)
    percents: dict[str, Any] = {"range": [0, 104], "tickvals": [0, 25, 50, 75, 100], "showgrid": False}
    figure.update_yaxes(title_text="cumulated, %", secondary_y=True, **percents)
    return figure


def dependence(name: str, shares: Sequence[Share]) -> go.Figure:
    """Success with its Wilson interval over classes of a value."""
    rates = [100 * s.rate for s in shares]
    low, high = ([abs(100 * s.bounds[k] - r) for s, r in zip(shares, rates, strict=True)] for k in (0, 1))
    figure = go.Figure(
        go.Scatter(
            x=[s.label for s in shares],
            y=rates,
            error_y={"type": "data", "array": high, "arrayminus": low, "symmetric": False, "color": "#9db4cc"},
            mode="markers",
            marker={"size": 9, "color": BLUE},
            customdata=[[s.good, s.n] for s in shares],
            hovertemplate="%{x}: %{y:.1f} % (%{customdata[0]} of %{customdata[1]})<extra></extra>",
        )
    )
    figure.update_layout(**LAYOUT, **_titled(name), height=270)
    figure.update_yaxes(range=[-4, 105], title_text="success, %")
    figure.update_xaxes(type="category")
    return figure


def bin_map(good: np.ndarray, tried: np.ndarray, inner: Sequence[float]) -> go.Figure:
    """Success by where in the bin the chosen workpiece lay, seen from above and to scale, with the bin's outline.

    Args:
        good, tried: (rows along y, columns along x) successes and attempts; cells without an attempt stay empty.
        inner: inner size of the bin along x and y [m].
    """
    ny, nx = tried.shape
    with np.errstate(invalid="ignore"):
        rate = np.where(tried > 0, 100 * good / np.maximum(tried, 1), np.nan)
    text = [[f"{g}/{n}" if n else "" for g, n in zip(*rows, strict=True)] for rows in zip(good, tried, strict=True)]
    half_x, half_y = 500 * inner[0], 500 * inner[1]  # [mm]
    figure = go.Figure(
        go.Heatmap(
            x=np.round(2 * half_x * ((np.arange(nx) + 0.5) / nx - 0.5), 1).tolist(),
            y=np.round(2 * half_y * ((np.arange(ny) + 0.5) / ny - 0.5), 1).tolist(),
            z=[[None if np.isnan(v) else float(v) for v in row] for row in rate],
            text=text,
            texttemplate="%{text}",
            hovertemplate="x %{x} mm, y %{y} mm: %{z:.1f} % (%{text})<extra></extra>",
            zmin=0,
            zmax=100,
            colorscale="Cividis",  # read alike with every kind of colour vision
            colorbar={"title": "%", "thickness": 14, "len": 0.9},
            xgap=1,
            ygap=1,
        )
    )
    figure.add_shape(type="rect", x0=-half_x, x1=half_x, y0=-half_y, y1=half_y, line={"color": INK, "width": 3})
    figure.update_layout(
        **LAYOUT, **_titled("place in the bin"), height=int(np.clip(90 + 400 * inner[1] / inner[0], 240, 520))
    )
    figure.update_xaxes(title_text="x in the bin [mm]", range=[-1.06 * half_x, 1.06 * half_x], constrain="domain")
    along_y: dict[str, Any] = {"scaleanchor": "x", "scaleratio": 1, "constrain": "domain"}
    figure.update_yaxes(title_text="y in the bin [mm]", range=[-1.06 * half_y, 1.06 * half_y], **along_y)
    return figure


def cycle(parts: Sequence[Mapping[str, Any]]) -> go.Figure:
    """Where the time of a cycle goes: mean of each part, one after the other, its name beside its bar."""
    figure = go.Figure()
    begin = 0.0
    for part in parts:
        figure.add_bar(
            y=[part["name"]],
            x=[part["mean"]],
            base=begin,
            orientation="h",
            marker_color=PARTS[part["name"]],
            text=f"{part['mean']:.2f} s",
            textposition="auto",
            hovertemplate=f"{part['name']}: mean {part['mean']:.2f} s, median {part['median']:.2f} s, "
            f"95 % under {part['high']:.2f} s<extra></extra>",
        )
        begin += part["mean"]
    figure.update_layout(**(LAYOUT | {"margin": LAYOUT["margin"] | {"l": 78}}), **_titled("one cycle"), height=250)
    figure.update_xaxes(title_text="[s] from the start of a cycle")
    figure.update_yaxes(autorange="reversed")
    return figure


def trend(
    labels: Sequence[str], rates: Sequence[float | None], bounds: Sequence[Sequence[float]], groups: Sequence[str]
) -> go.Figure:
    """The rate of many runs with its interval, in the order given; runs of one group are joined by a line."""
    figure = go.Figure()
    colours = (BLUE, "#b35900", "#2f7d4f", "#7a4fa3", "#8a6d00", "#a03050")
    for colour, group in zip(itertools.cycle(colours), dict.fromkeys(groups), strict=False):
        mine = [i for i, g in enumerate(groups) if g == group and rates[i] is not None]
        points = [100.0 * (rates[i] or 0.0) for i in mine]
        low, high = ([abs(100 * bounds[i][k] - y) for i, y in zip(mine, points, strict=True)] for k in (0, 1))
        figure.add_scatter(
            x=mine,
            y=points,
            error_y={"type": "data", "array": high, "arrayminus": low, "symmetric": False, "thickness": 1},
            mode="lines+markers",
            marker={"size": 9, "color": colour},
            line={"color": colour, "width": 1},
            name=group,
            text=[labels[i] for i in mine],
            hovertemplate="%{text}: %{y:.1f} %<extra></extra>",
        )
    figure.update_layout(**(LAYOUT | {"showlegend": len(set(groups)) > 1}), height=320)
    figure.update_xaxes(tickvals=list(range(len(labels))), ticktext=list(labels))
    figure.update_yaxes(title_text="pick success, %", range=[-4, 105])
    return figure
