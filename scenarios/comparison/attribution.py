"""What each stage of a pick costs: campaigns over the same bins in which one stage more is replaced by ground truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from pickproof.scenarios.comparison.difference import Difference, cleared_of, counts_of, difference_of, points, span
from pickproof.scenarios.comparison.paired import Outcome, same_seeds
from pickproof.scenarios.config.oracles import ORACLES
from pickproof.scenarios.results.records import NO_PICK_REASONS, Reason
from pickproof.scenarios.results.summary import interval, percent

MODES: tuple[tuple[str, ...], ...] = tuple(ORACLES[:k] for k in range(len(ORACLES) + 1))
"""Each replaces one stage more, in the order of a pick: what comes first is made perfect before the next is judged."""
RESAMPLES = 10_000
LEFT: dict[str, tuple[Reason, ...]] = {
    "the grasp points": (Reason.MISSED, Reason.DOUBLE_PICK, Reason.COLLISION),
    "the grip": (Reason.SLIPPED, Reason.DROPPED),
    "placing": (Reason.MISPLACED,),
}
"""What an attempt that fails with every stage replaced points at: the pose was true, the candidate the best of the
table by rehearsal, no arm in the way. The jaws closed beside it: the points; it was held and lost: force, friction and
pads. Every other reason points at the scenario."""
SCENARIO = "the scenario"


@dataclass(frozen=True)
class Stage:
    """What replacing one stage gains, with all stages before it replaced already.

    Attributes:
        success, clearance: gain of the rate; None where an arm never moved.
        bootstrap95: of the success gained, by cluster bootstrap over episodes; too narrow for few
            (docs/explanation/attribution.md).
        most: share of the bootstrap's campaigns in which this stage costs success, and more than any other.
        no_picks: before and after.
    """

    name: str
    success: Difference | None
    clearance: Difference | None
    bootstrap95: tuple[float, float] | None
    most: float | None
    no_picks: tuple[int, int]


@dataclass(frozen=True)
class Attribution:
    """The costs of all stages over the same bins.

    Attributes:
        summaries: of the campaigns, in the order of MODES.
        named: the stage to mend first; None where nothing can be told from nothing. basis: what names it.
        rest: share of failed attempts that no oracle mends.
        rest_points_at: what most of those point at, see LEFT; None where nothing failed.
        rest_by_grasp: grasp point -> how many of those, most first.
    """

    episodes: int
    summaries: list[dict[str, Any]]
    stages: list[Stage]
    named: str | None
    basis: str
    rest: float | None
    rest_points_at: str | None
    rest_by_grasp: dict[str, int]


def attribute(
    outcomes: Sequence[Sequence[Outcome]],
    summaries: Sequence[dict[str, Any]],
    files: Sequence[Path],
    rest_by_grasp: Mapping[str, int] | None = None,
) -> Attribution:
    """Costs of the stages from the episodes of each campaign, in the order of MODES.

    Args:
        rest_by_grasp: failed attempts of the last one by grasp point.

    Raises:
        InputError: two campaigns share no seed, or a seed dropped another number of workpieces; names the file.
    """
    sides = [list(outcomes[0])]
    for own, file in zip(outcomes[1:], files[1:], strict=True):
        first, own = same_seeds(sides[0], own, file)
        sides = [[o for o in side if o.seed in {f.seed for f in first}] for side in sides] + [list(own)]
    sides = [sorted(side, key=lambda o: o.seed) for side in sides]
    gains = _bootstrap(sides)
    stages = []
    for k, name in enumerate(ORACLES):
        before, after = sides[k], sides[k + 1]
        moved = all(any(o.attempts for o in side) for side in (before, after))
        bounds = np.quantile(gains[:, k], (0.025, 0.975)) if gains is not None else None
        stages.append(
            Stage(
                name=name,
                success=difference_of(counts_of(before), counts_of(after)) if moved else None,
                clearance=difference_of(cleared_of(before), cleared_of(after))
                if any(o.dropped for o in after)
                else None,
                bootstrap95=None if bounds is None else (float(bounds[0]), float(bounds[1])),
                most=None if gains is None else float(((gains.argmax(1) == k) & (gains[:, k] > 0)).mean()),
                no_picks=(summaries[k]["no_picks"], summaries[k + 1]["no_picks"]),
            )
        )
    named, basis = _named(stages)
    rate = summaries[-1]["success_rate"]
    rest = None if rate is None else 1.0 - float(rate)
    points_at, by_grasp = _points_at(summaries[-1]["reasons"]), dict(Counter(rest_by_grasp or {}).most_common())
    return Attribution(len(sides[0]), list(summaries), stages, named, basis, rest, points_at, by_grasp)


def _points_at(reasons: Mapping[str, int]) -> str | None:
    """What most failed attempts point at; of equals the first in the order of LEFT."""
    failed = Counter({Reason(reason): n for reason, n in reasons.items() if Reason(reason) not in NO_PICK_REASONS})
    counts = {name: sum(failed.pop(reason, 0) for reason in own) for name, own in LEFT.items()}
    counts[SCENARIO] = failed.total()
    return max(counts, key=lambda name: counts[name]) if any(counts.values()) else None


def _named(stages: Sequence[Stage]) -> tuple[str | None, str]:
    """The stage whose cost in success is largest of those that exclude 0; where none does, in clearance."""
    for basis in ("success", "clearance"):
        costs = {s.name: d for s in stages if (d := getattr(s, basis)) is not None and d.interval95[0] > 0}
        if costs:
            return max(costs, key=lambda name: costs[name].difference), basis
    return None, "none"


def _bootstrap(sides: Sequence[Sequence[Outcome]]) -> np.ndarray | None:
    """Gains of success (RESAMPLES, stages) over episodes drawn again, the same draw for every campaign."""
    successes = np.array([counts_of(side)[0] for side in sides], dtype=float)
    attempts = np.array([counts_of(side)[1] for side in sides], dtype=float)
    if not attempts.sum(1).all():
        return None
    drawn = np.random.default_rng(0).integers(0, attempts.shape[1], (RESAMPLES, attempts.shape[1]))
    total = np.maximum(attempts[:, drawn].sum(2), 1.0)
    return np.diff(successes[:, drawn].sum(2) / total, axis=0).T


def leads_the_rest(a: Attribution) -> bool:
    """What fails with all stages replaced is, at the lower end of its interval, more than any stage costs."""
    costs = [s.success.difference for s in a.stages if s.success is not None]
    return a.rest is not None and 1.0 - a.summaries[-1]["cluster95"][1] > max(0.0, *costs)


def verdict_line(a: Attribution) -> str:
    """What to mend first, in a sentence."""
    if leads_the_rest(a):
        left = _left(a)
        return f"mend {a.rest_points_at} first: with every stage replaced {percent(a.rest)} still fail{left}"
    if a.named is None:
        lead = max((s for s in a.stages if s.most), key=lambda s: s.most or 0.0, default=None)
        seen = (
            ""
            if lead is None or lead.success is None
            else f"; seen most: {lead.name} {points(lead.success.difference)}"
        )
        return f"no evidence: no stage's cost can be told from nothing over {a.episodes} episodes{seen}"
    stage = next(s for s in a.stages if s.name == a.named)
    cost: Difference = getattr(stage, a.basis)
    what = "pick success" if a.basis == "success" else "clearance"
    return f"mend {a.named} first: it costs {points(cost.difference)[1:]} points of {what} [{span(cost.interval95)}]"


def print_attribution(console: Console, a: Attribution) -> None:
    """The table and the verdict; `costs` in points of pick success, `most` as `Stage.most`."""
    table = Table(title=f"{a.summaries[0]['scenario']}: {a.episodes} bins, each with one oracle more")
    for column in ("oracle", "success\n95 %", "costs\n95 %", "most", "cleared", "no-picks"):
        table.add_column(column, justify="left" if column == "oracle" else "right", no_wrap=True)
    for k, (mode, s) in enumerate(zip(MODES, a.summaries, strict=True)):
        cost: tuple[str, ...] = ("", "")
        if k:
            stage = a.stages[k - 1]
            if stage.success is not None:
                cost = (f"{points(stage.success.difference)}\n{span(stage.success.interval95)}", percent(stage.most, 0))
        name = f"+ {mode[-1]}" if mode else "none"
        rate = f"{percent(s['success_rate'])}\n{interval(s['cluster95'])}"
        table.add_row(name, rate, *cost, percent(s["clearance"]), str(s["no_picks"]))
    console.print(table)
    left = f"left when all are replaced: {percent(a.rest)} of the attempts fail{_left(a)}"
    console.print(left, soft_wrap=True, highlight=False)
    console.print(f"[bold]{verdict_line(a)}[/]", soft_wrap=True, highlight=False)


def _left(a: Attribution) -> str:
    """What still failed, in brackets: reasons, those of no-picks too, and grasp points of attempts."""
    listed = [
        ", ".join(f"{name} {n}" for name, n in counts.items())
        for counts in (a.summaries[-1]["reasons"], a.rest_by_grasp)
    ]
    return f" ({'; with '.join(filter(None, listed))})" if any(listed) else ""


def plot_attribution(a: Attribution, path: Path) -> None:
    """Left the rate with one oracle more each, right the cost of each stage; bars: 95 %, squares: clearance."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.4, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(4, 3))
    names = ["as it is", *(f"+ {name}" for name in ORACLES)]
    rate = np.array([np.nan if s["success_rate"] is None else s["success_rate"] for s in a.summaries])
    reach = np.clip(np.abs(np.array([s["cluster95"] for s in a.summaries]).T - rate), 0, None)
    left.errorbar(range(len(names)), 100 * rate, 100 * reach, fmt="o", color="#1f5fa8", capsize=4, label="pick success")
    cleared = [np.nan if s["clearance"] is None else 100 * s["clearance"] for s in a.summaries]
    left.plot(range(len(names)), cleared, "s", mfc="none", color="#b35900", label="clearance")
    left.set_xticks(range(len(names)), names)
    left.set_xlim(-0.4, len(names) - 0.6)
    left.set_ylabel("%")
    left.set_title("ground truth in place of one stage more", fontsize=10)
    left.legend(fontsize=8)
    for k, stage in enumerate(a.stages):
        if stage.clearance is not None:
            right.plot(100 * stage.clearance.difference, k, "s", mfc="none", color="#b35900", zorder=3)
        if stage.success is None:  # an arm that never moved has no rate
            continue
        d = stage.success
        colour = "#c2463a" if stage.name == a.named else "#7d8896"
        right.barh(k, 100 * d.difference, color=colour, height=0.55)
        ends = [[100 * (d.difference - d.interval95[0])], [100 * (d.interval95[1] - d.difference)]]
        right.errorbar(100 * d.difference, k, xerr=ends, fmt="none", color="#1b2430", capsize=4)
    right.set_yticks(range(len(a.stages)), [s.name for s in a.stages])
    right.invert_yaxis()
    right.axvline(0, color="#1b2430", linewidth=0.8)
    right.set_xlabel("points of success; squares: clearance")
    right.set_title("what the stage costs", fontsize=10)
    for panel in (left, right):
        panel.grid(axis="y" if panel is left else "x", alpha=0.3)
        panel.set_axisbelow(True)
    figure.savefig(path, dpi=130)
