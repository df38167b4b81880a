"""What `pickproof tune` found: in the terminal, as JSON, and as one self-contained page that fetches nothing."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from pickproof.cell.frames import rotation_angle
from pickproof.cell.grippers.registry import load_gripper
from pickproof.cell.html_page import page_template
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.grasping.grasp_points import GraspPoint, opening
from pickproof.scenarios.comparison.compare_text import verdict_line
from pickproof.scenarios.comparison.difference import points as in_points
from pickproof.scenarios.comparison.difference import span
from pickproof.scenarios.files.atomic import write_whole
from pickproof.scenarios.reporting.figures import as_json, library
from pickproof.scenarios.reporting.part_pictures import moved_picture
from pickproof.scenarios.results.summary import percent
from pickproof.scenarios.tuning.cell_stage import CELL
from pickproof.scenarios.tuning.figures import best_so_far, cells, importance_of_cells, importance_of_grasps
from pickproof.scenarios.tuning.grasp_space import grip_axes
from pickproof.scenarios.tuning.plan import Plan
from pickproof.scenarios.tuning.run import Result

REPORT = "tune.html"


@dataclass(frozen=True)
class Move:
    """What the proposal changes of one grasp point, in words and a picture; empty where it stays."""

    centre: str
    turned: str
    depth: str
    jaws: str
    priority: str
    picture: str


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


def move(plan: Plan, old: GraspPoint, new: GraspPoint) -> Move:
    """What differs between a grasp point as it was and as proposed; the picture is a PNG in base64."""
    shift = 1000 * (np.asarray(new.centre) - old.centre)
    turn = np.degrees(float(rotation_angle(grip_axes(old).T @ grip_axes(new))))
    deeper = 1000 * (new.depths[0] - old.depths[0])
    narrow, wide = (1000 * opening(p) for p in (old, new))
    moved = bool(np.abs(shift).max() > 0.005 or turn > 0.05 or abs(deeper) > 0.005 or abs(wide - narrow) > 0.005)
    picture = b""
    if moved:
        mesh, gripper = load_workpiece(plan.scenario.workpiece).mesh, load_gripper(plan.scenario.gripper)
        picture = moved_picture(mesh, old, new, gripper)
    return Move(
        centre=", ".join(f"{v:+.1f}" for v in shift) if np.abs(shift).max() > 0.005 else "",
        turned=f"{turn:.1f}" if turn > 0.05 else "",
        depth=f"{deeper:+.1f}" if abs(deeper) > 0.005 else "",
        jaws=_from_to(narrow, wide, 1),
        priority=_from_to(old.priority, new.priority, 2),
        picture=b64encode(picture).decode(),
    )


def _from_to(before: float, after: float, digits: int) -> str:
    return f"{before:.{digits}f} \u2192 {after:.{digits}f}" if abs(after - before) > 0.1**digits / 2 else ""


def write_tune_report(plan: Plan, result: Result, path: Path) -> Path:
    """Write the page.

    Raises:
        StoreError: it cannot be written.
    """
    figures = {}
    grasps = {name: t for name, t in result.history.items() if name != CELL and t}
    if grasps:
        figures["grasps"] = as_json(best_so_far(grasps))
    if result.history.get(CELL):
        figures["cells"] = as_json(cells(result.history[CELL]))
    known = {name: shares for name, shares in result.importances.items() if shares}
    if CELL in known:
        figures["of-cells"] = as_json(importance_of_cells(known.pop(CELL)))
    if known:
        figures["of-grasps"] = as_json(importance_of_grasps(known))
    template = page_template("pickproof.scenarios.tuning", "tune.html.j2", percent=percent)
    old = {p.name: p for p in plan.points}
    page = template.render(
        plan=plan,
        result=result,
        moves={p.name: move(plan, old[p.name], p) for p in result.points if p.name in plan.names},
        factor=_approach_factor(plan.points, result.points),
        fields=[(name, _field(plan, name), value) for name, value in result.fields.items()],
        figures=figures,
        verdict=verdict_line(result.comparison) if result.comparison else "",
        rows=_rows(result),
        plotly=library() if figures else "",
        trials=sum(len(t) for name, t in result.history.items() if name != CELL),
        candidates=len(result.history.get(CELL, [])),
    )
    return write_whole(path, page)


def _approach_factor(before: Sequence[GraspPoint], after: Sequence[GraspPoint]) -> float:
    """Of the approach distances, which change together."""
    return max((b.approach_distance / a.approach_distance for a, b in zip(before, after, strict=True)), key=_off)


def _off(factor: float) -> float:
    return abs(factor - 1)


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
