"""Figures of the page that `pickproof tune` writes: the search of the grasps, the race of cells, what mattered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from pickproof.scenarios.reporting.figures import BAD, BLUE, GOOD, IDLE, LAYOUT
from pickproof.scenarios.tuning.cell_space import TABLE
from pickproof.scenarios.tuning.optimizer import Trial

SHOWN = 12  # parameters in the figure of importance


def best_so_far(grasps: Mapping[str, Sequence[Trial]]) -> go.Figure:
    """The best value of each grasp over its trials."""
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


def cells(trials: Sequence[Trial]) -> go.Figure:
    """Gain of every candidate over the start, with its interval."""
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
                "symbol": ["diamond" if t.values.get(TABLE) else "circle" for t in trials],
                "line": {"width": 0},
                "size": [8 + 1.2 * t.detail["episodes"] ** 0.8 for t in trials],
                "color": [GOOD if i == best else (BAD if t.detail["dropped"] else BLUE) for i, t in enumerate(trials)],
            },
            customdata=[[t.detail["episodes"], 100 * t.detail["rate"]] for t in trials],
            hovertemplate="%{y:+.1f} points in %{customdata[0]} bins, %{customdata[1]:.1f} %<extra></extra>",
        )
    )
    figure.add_hline(y=0, line_color=IDLE, line_width=1)
    figure.update_layout(**LAYOUT, height=340)
    figure.update_xaxes(title_text="candidate", tickmode="array", tickvals=list(range(1, len(trials) + 1)))
    figure.update_yaxes(title_text="gain, points")
    return figure


def importance_of_grasps(shares: Mapping[str, Mapping[str, float]]) -> go.Figure:
    """Parameters against grasps, in percent of what sets the best trials apart."""
    names = sorted(
        {p for of in shares.values() for p in of}, key=lambda p: -sum(of.get(p, 0.0) for of in shares.values())
    )
    z = [[100 * of[p] if p in of else None for p in names] for of in shares.values()]
    figure = go.Figure(
        go.Heatmap(
            z=z,
            x=[p.replace("_", ", ") for p in names],
            y=list(shares),
            zmin=0,
            zmax=100,
            xgap=2,
            ygap=2,
            colorscale=[[0, "#f1f4f8"], [1, BLUE]],
            showscale=False,
            texttemplate="%{z:.0f}",
            hovertemplate="%{y}: %{x} %{z:.0f} %<extra></extra>",
        )
    )
    figure.update_layout(**LAYOUT, height=90 + 26 * len(z))
    figure.update_yaxes(autorange="reversed", automargin=True)
    return figure


def importance_of_cells(shares: Mapping[str, float]) -> go.Figure:
    """The same of the parameters of whole cells, largest first."""
    top = sorted(shares.items(), key=lambda item: item[1])[-SHOWN:]
    figure = go.Figure(go.Bar(x=[100 * v for _, v in top], y=[k for k, _ in top], orientation="h", marker_color=BLUE))
    figure.update_layout(**LAYOUT, height=90 + 22 * len(top))
    figure.update_xaxes(range=[0, 100], title_text="%")
    figure.update_yaxes(automargin=True)
    return figure
