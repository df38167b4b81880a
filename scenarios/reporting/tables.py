"""Counts that the report shows: shares with their intervals, and what ruled grasps out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pickproof.cell.frames import apply, invert
from pickproof.cell.geometry.bin import Bin
from pickproof.grasping.candidates import COVER_COUNTS
from pickproof.grasping.verdict import CHOSEN, Verdict
from pickproof.grasping.verdict import MEANING as VERDICTS
from pickproof.scenarios.reporting.verdict_counts import verdict_counts
from pickproof.scenarios.results.records import AttemptRecord
from pickproof.scenarios.statistics.intervals import wilson

FILL_STEPS = 6
GRID = (6, 5)
"""Cells of the heat map along and across the bin."""


@dataclass(frozen=True)
class Share:
    """A count with its rate and Wilson interval, as a row of a table or a bar."""

    label: str
    good: int
    n: int

    @property
    def rate(self) -> float:
        """Share of the good ones; 0 where there are none."""
        return self.good / self.n if self.n else 0.0

    @property
    def bounds(self) -> tuple[float, float]:
        """Its 95 % interval (Wilson)."""
        return wilson(self.good, self.n)


def fill_levels(attempts: Sequence[AttemptRecord], steps: int = FILL_STEPS) -> list[Share]:
    """Success by workpieces in the bin when the attempt began, in at most `steps` classes of equal width."""
    moved = [a for a in attempts if a.moved]
    most = max((a.parts_in_bin_before for a in moved), default=0)
    width = max(1, -(-most // steps))
    shares = []
    for low in range(1, most + 1, width):
        mine = [a for a in moved if low <= a.parts_in_bin_before < low + width]
        high = min(low + width - 1, most)
        label = f"{low} to {high}" if high > low else str(low)
        shares.append(Share(label, sum(a.success for a in mine), len(mine)))
    return shares


def classes(
    attempts: Sequence[AttemptRecord], value: Callable[[AttemptRecord], float | None], edges: Sequence[float], unit: str
) -> list[Share]:
    """Success of the attempts that moved by a value of theirs, in classes between `edges`, the last one open above."""
    known = [(v, a.success) for a in attempts if a.moved and (v := value(a)) is not None]
    at = np.clip(np.searchsorted(edges, [v for v, _ in known], side="right") - 1, 0, len(edges) - 1)
    shares = []
    for i, low in enumerate(edges):
        mine = [good for k, (_, good) in zip(at, known, strict=True) if k == i]
        label = f"{low:g} to {edges[i + 1]:g}{unit}" if i + 1 < len(edges) else f"over {low:g}{unit}"
        if mine:
            shares.append(Share(label, sum(mine), len(mine)))
    return shares


def uncovered_percent(attempt: AttemptRecord) -> float | None:
    """Share in % of the chosen workpiece on which nothing else was measured, from its ranking."""
    for estimate in attempt.tree if isinstance(attempt.tree, list) else ():
        for candidate in estimate.get("candidates", ()):
            if candidate["verdict"] == CHOSEN and "uncovered" in candidate["terms"]:
                return 100 * (1.0 - (1.0 - float(candidate["terms"]["uncovered"])) / COVER_COUNTS)
    return None


def tilt_deg(attempt: AttemptRecord) -> float | None:
    """Angle in [deg], 0 to 90, between the CAD's z axis at the chosen estimate and the vertical."""
    if attempt.estimate_T_world_part is None:
        return None
    z = abs(attempt.estimate_T_world_part[2][2])
    return float(np.rad2deg(np.arccos(min(z, 1.0))))


def by_place(attempts: Sequence[AttemptRecord], source: Bin) -> tuple[np.ndarray, np.ndarray]:
    """Successes and attempts by where in the bin the chosen estimate lay, (GRID[1], GRID[0]) each, y upwards."""
    moved = [a for a in attempts if a.moved and a.estimate_T_world_part is not None]
    good, tried = np.zeros((GRID[1], GRID[0]), int), np.zeros((GRID[1], GRID[0]), int)
    if moved:
        at = np.array([[row[3] for row in (a.estimate_T_world_part or ())[:3]] for a in moved])
        local = apply(invert(source.T_world_bin), at)[:, :2] / source.inner[:2] + 0.5
        column, row = np.clip((local * GRID).astype(int), 0, np.array(GRID) - 1).T
        np.add.at(tried, (row, column), 1)
        np.add.at(good, (row, column), [a.success for a in moved])
    return good, tried


@dataclass(frozen=True)
class GraspRow(Share):
    """A grasp point: how often used, with what success, and what ruled its poses out."""

    ruled_out: Counter[str] = field(default_factory=Counter)

    @property
    def why(self) -> str:
        """What ruled out at least 1 % of its poses, most frequent first."""
        total = self.ruled_out.total()
        shares = [(v, n / total) for v, n in self.ruled_out.most_common()] if total else []
        return ", ".join(f"{v.replace('_', ' ')} {100 * s:.0f} %" for v, s in shares if s >= 0.01)


def grasp_points(attempts: Sequence[AttemptRecord]) -> list[GraspRow]:
    """Every grasp point that was looked at, most used first."""
    used = Counter(a.grasp or "(none)" for a in attempts if a.moved)
    good = Counter(a.grasp or "(none)" for a in attempts if a.success)
    ruled_out: dict[str, Counter[str]] = {}
    for attempt in attempts:
        for estimate in attempt.tree if isinstance(attempt.tree, list) else ():
            for name, counts in estimate.get("ruled_out", {}).items():
                ruled_out.setdefault(name, Counter()).update(counts)
            for candidate in estimate.get("candidates", ()):
                if candidate["verdict"] != CHOSEN:
                    ruled_out.setdefault(candidate["grasp"], Counter())[candidate["verdict"]] += 1
    names = [name for name, _ in used.most_common()] + sorted(ruled_out.keys() - used.keys())
    return [GraspRow(name, good[name], used[name], ruled_out.get(name, Counter())) for name in names]


def cycle_parts(attempts: Sequence[AttemptRecord]) -> list[dict[str, Any]]:
    """Mean, median and 95 % quantile in [s] of each part of the cycle, over the attempts that moved."""
    moved = [a for a in attempts if a.moved]
    rows = []
    for name in ("sensing", "perceive", "choose", "plan", "robot") if moved else ():
        times = np.array([getattr(a, f"{name}_s") for a in moved])
        median, high = np.quantile(times, (0.5, 0.95))
        rows.append({"name": name, "mean": float(times.mean()), "median": float(median), "high": float(high)})
    return rows


def verdict_rows(attempts: Sequence[AttemptRecord]) -> list[tuple[Verdict, int, float, str]]:
    """Verdict, grasp poses that it ruled out, their share of all, and what it means; none without trees."""
    counts: Counter[str] = Counter()
    for attempt in attempts:
        counts.update(verdict_counts(attempt.tree) if isinstance(attempt.tree, list) else {})
    total = sum(counts.values())
    return [(v, counts[v], counts[v] / total, VERDICTS[v]) for v in Verdict if counts[v]]
