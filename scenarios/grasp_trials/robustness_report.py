"""The robustness of grasps as a table and as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from pickproof.scenarios.grasp_trials.robustness import AXES, KEYS, Robustness, beyond, sizes_of

COLUMNS = 3
GOOD, BAD, BASE = "#8fcbab", "#d9776c", "#1b2430"


def robustness_table(grasps: Sequence[Robustness], errors: dict[str, float] | None) -> Table:
    """Table of tolerated errors by grasp and direction, negative / positive; red where perception's are larger."""
    table = Table(title="pose errors that each grasp tolerates, - / +, in mm and degrees", title_justify="left")
    table.add_column("grasp point", overflow="fold")
    for axis in (*AXES, "held"):
        table.add_column(axis, justify="right", no_wrap=True)
    if errors is not None:
        p95 = [f"{errors[key]:.2g}" for key in KEYS]
        table.add_row("[dim]perception, 95 % under[/]", *(f"[dim]{p}[/]" for p in p95), "", end_section=True)
    for g in grasps:
        failing = beyond(g, errors) if errors is not None else []
        cells = [f"{low:g}/{high:g}" for low, high in g.tolerated]
        shown = [f"[red]{c}[/]" if a in failing else c for a, c in enumerate(cells)]
        table.add_row(g.grasp, *shown, f"{100 * g.share:.0f} %")
    return table


def plot_robustness(grasps: Sequence[Robustness], errors: dict[str, float] | None, title: str, path: Path) -> None:
    """A panel a grasp: held (green) or lost (red) over direction and size of the error; bars are perception's."""
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    columns = min(COLUMNS, len(grasps))
    rows = -(-len(grasps) // columns)
    figure = Figure(figsize=(4.4 * columns, 2.7 * rows + 0.9), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    steps = len(sizes_of(0))
    labels = [f"{mm:g} | {deg:g}" for mm, deg in zip(sizes_of(0), sizes_of(3), strict=True)]
    for panel, grasp in zip(grid, grasps, strict=False):
        panel.imshow(grasp.held, cmap=ListedColormap([BAD, GOOD]), vmin=0, vmax=1, aspect="auto", interpolation="none")
        panel.set_yticks(range(len(AXES)), [f"{a} {along}" for a, along in zip(AXES, grasp.along, strict=True)])
        panel.set_xticks(range(2 * steps + 1), [*("-" + s for s in reversed(labels)), "0", *("+" + s for s in labels)])
        panel.tick_params(axis="x", rotation=90, labelsize=6, length=2)
        panel.tick_params(axis="y", labelsize=8, length=0)
        for k in range(1, 2 * steps + 1):
            panel.axvline(k - 0.5, color="white", lw=1)
        for a in range(len(AXES)):
            panel.axhline(a - 0.5, color="white", lw=2 if a != 3 else 5)
            if errors is not None:
                at = float(np.interp(errors[KEYS[a]], (0.0, *sizes_of(a)), range(steps + 1)))
                panel.plot([steps - at, steps + at], [a, a], "|-", color=BASE, lw=1.2, ms=7)
        panel.set_title(grasp.grasp + (f": {grasp.reason}" if grasp.reason else ""), fontsize=9, loc="left")
    for panel in grid[len(grasps) :]:
        panel.set_visible(False)
    keys = [Patch(color=GOOD, label="held"), Patch(color=BAD, label="lost")]
    if errors is not None:
        keys.append(Patch(color=BASE, label="errors of perception, 95 % within the bar"))
    figure.legend(handles=keys, loc="outside lower center", ncols=3, fontsize=8)
    figure.suptitle(f"{title}: error of the pose, mm | deg", fontsize=11, x=0.01, ha="left")
    figure.savefig(path, dpi=130)
