"""evaluation.html: results and failures of `pickproof evaluate` on one self-contained page."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pickproof.cell.html_page import page_template, png_uri
from pickproof.cell.workpiece.workpiece import Workpiece
from pickproof.perception.data.overlay import Pictured, draw_frame, draw_legend, png
from pickproof.perception.evaluation.analysis import Instances
from pickproof.perception.evaluation.metrics import VISIBILITY, FrameScore

BLUE, RED, GREY = "#2f6fb3", "#c2463a", "#b9c4d0"


@dataclass(frozen=True)
class Evaluation:
    """What the page shows.

    Attributes:
        data: evaluation.json.
        instances: all true instances.
        scores: of the verified poses, one a frame.
        worst: seed, score and content of the frames to be shown.
    """

    workpiece: Workpiece
    data: dict[str, Any]
    instances: Instances
    scores: list[FrameScore]
    worst: list[tuple[int, FrameScore, Pictured]]


def write_page(evaluation: Evaluation, path: Path) -> None:
    """Write the page."""
    workpiece, data = evaluation.workpiece, evaluation.data
    frames = [(seed, score, png_uri(png(draw_frame(p, workpiece)))) for seed, score, p in evaluation.worst]
    width = evaluation.worst[0][2].frame.depth.shape[1] if evaluation.worst else 640
    page = page_template("pickproof.perception.evaluation", "evaluation.html.j2").render(
        data=data,
        methods=data["methods"],
        frames=frames,
        threshold=VISIBILITY,
        n_instances=len(evaluation.instances.visibility),
        legend=png_uri(png(draw_legend(width, workpiece.tolerance))),
        visibility=png_uri(draw_visibility(evaluation.instances, data["recall_by_visibility"], workpiece.tolerance)),
        calibration=png_uri(draw_reliability(data["calibration"])),
        errors=png_uri(draw_errors(evaluation.scores)),
    )
    path.write_text(page, encoding="utf-8")


def draw_visibility(instances: Instances, recall: list[dict[str, Any]], tolerance: float) -> bytes:
    """PNG: recall by visibility, and the error of the nearest prediction of each instance against its visibility."""
    figure = Figure(figsize=(11, 3.7), layout="constrained")
    counts, error, turn = figure.subplots(1, 3)
    middle = [(row["low"] + row["high"]) / 2 for row in recall]
    found, count = np.array([r["found"] for r in recall]), np.array([r["count"] for r in recall])
    width = 0.9 / len(recall)
    counts.bar(middle, found, width, color=BLUE, alpha=0.45, label="found")
    counts.bar(middle, count - found, width, bottom=found, color=RED, alpha=0.45, label="not found")
    for x, n in zip(middle, count, strict=True):
        counts.annotate(str(n), (x, n), ha="center", va="bottom", fontsize=7)
    counts.set(xlabel="visibility", ylabel="instances", ylim=(0, 1.2 * max(count.max(initial=1), 1)))
    counts.legend(fontsize=7, loc="upper left")
    share = counts.twinx()
    share.plot(middle, [np.nan if r["recall"] is None else r["recall"] for r in recall], "o-", color="black", ms=3)
    share.set(ylabel="found [%] (line)", ylim=(0, 105))
    for kind, colour, marker, name in (
        (instances.found, BLUE, ".", "found"),
        (~instances.found, RED, "x", "not found"),
    ):
        shown = kind & np.isfinite(instances.distance)
        error.plot(instances.visibility[shown], 1e3 * instances.distance[shown], marker, color=colour, ms=4, label=name)
    error.axhline(1e3 * tolerance, color="black", lw=0.8, ls="--", label="T_e")
    error.set(xlabel="visibility", ylabel="D of the nearest prediction [mm]", yscale="log")
    error.legend(fontsize=7)
    angle = np.rad2deg(instances.rotation[instances.found])
    turn.plot(instances.visibility[instances.found], angle, ".", color=BLUE, ms=4)
    turn.set(xlabel="visibility", ylabel="rotation error of the found ones [deg]", yscale="log")
    for axes in (counts, error, turn):
        axes.axvline(VISIBILITY, color="black", lw=0.8, ls=":")
        axes.set_xlim(0, 1.02)
    return _png(figure)


def draw_reliability(calibration: dict[str, Any]) -> bytes:
    """PNG: share of right poses against score, and their number, before the thresholds of verification and after."""
    figure = Figure(figsize=(8, 3.7), layout="constrained")
    for axes, curve, name in zip(
        figure.subplots(1, 2),
        (calibration["standing"], calibration),
        ("before the thresholds", "verified"),
        strict=True,
    ):
        rows = curve["bins"]
        score, count = [r["mean_score"] for r in rows], [r["count"] for r in rows]
        axes.plot([0, 1], [0, 1], color=GREY, lw=1)
        axes.plot(score, [r["share_right"] for r in rows], "o-", color=BLUE, ms=4)
        axes.set(xlabel="score", ylabel="share right (line)", xlim=(-0.02, 1.02), ylim=(-0.02, 1.05))
        axes.set_title(f"{name}: {sum(count)}, ECE {curve['ece']:.4f}", fontsize=10)
        number = axes.twinx()
        number.bar([min(int(10 * s), 9) / 10 + 0.05 for s in score], count, 0.09, color=GREY, alpha=0.5)
        number.set(ylabel="poses (bars)", yscale="log", ylim=(0.5, 3 * max(count, default=1)))
        axes.set_zorder(number.get_zorder() + 1)
        axes.patch.set_visible(False)
    return _png(figure)


def draw_errors(scores: list[FrameScore]) -> bytes:
    """PNG: histograms of translation and rotation error of the true positives."""
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    for axes, errors, name in zip(
        figure.subplots(1, 2),
        (1e3 * np.concatenate([s.distances for s in scores]), np.rad2deg(np.concatenate([s.angles for s in scores]))),
        ("translation error [mm]", "rotation error [deg]"),
        strict=True,
    ):
        axes.hist(errors, bins=40, color=BLUE)
        axes.set(xlabel=name, ylabel="true positives")
        if len(errors):
            median, high = np.median(errors), np.percentile(errors, 95)
            axes.axvline(median, color="black", lw=1)
            axes.axvline(high, color="black", lw=1, ls="--")
            axes.set_title(f"median {median:.3f}, 95 % below {high:.3f}", fontsize=10)
    return _png(figure)


def _png(figure: Figure) -> bytes:
    FigureCanvasAgg(figure)
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=110)
    return file.getvalue()
