"""What a campaign comes to: DIR/summary.json, and the same as text."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from math import ceil, floor
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from pickproof.scenarios.files.atomic import write_json
from pickproof.scenarios.results.record_hash import record_hash
from pickproof.scenarios.results.records import ENDS, AttemptRecord, Reason
from pickproof.scenarios.results.store import Store
from pickproof.scenarios.statistics.intervals import cluster_interval, wilson

FILE = "summary.json"
CLEARANCE_WANTED = 0.9
"""Clearance below which a rate alone would mislead: a good part of the workpieces stays in the bin."""


def summarise(store: Store, attempts: Sequence[AttemptRecord] | None = None) -> dict[str, Any]:
    """The summary of a results file, with the keys of docs/reference/files.md.

    Rates count attempts, finished episodes or not; clearance, parts left and ends count finished episodes. Mean times
    are over attempts that were carried out; `picks_per_hour` counts the time of no-picks too. `reasons` holds the
    no-picks too.

    Args:
        attempts: those of the store, where they have been read already.
    """
    meta, episodes = store.meta(), store.episodes()
    records = store.attempts(large=False) if attempts is None else attempts
    moved = [a for a in records if a.moved]
    successes = sum(a.success for a in moved)
    per_episode: dict[int, list[int]] = {}
    for a in moved:
        counts = per_episode.setdefault(a.seed, [0, 0])
        counts[0] += a.success
        counts[1] += 1
    rate = successes / len(moved) if moved else None
    dropped = sum(e.parts_dropped for e in episodes)
    cycle = _mean_cycle([a for a in moved if a.reason != Reason.SIMULATION_ERROR])
    ended = {e.seed for e in episodes}
    in_episodes = sum(a.seed in ended for a in moved)
    return {
        "scenario": json.loads(meta["scenario"])["name"],
        "scenario_hash": meta["scenario_hash"],
        "weights_hash": meta["weights_hash"],
        "inputs_hash": meta.get("inputs_hash", ""),
        "seed": meta["seed"],
        "episodes": len(episodes),
        "oracle": meta["oracle"],
        "attempts": len(moved),
        "successes": successes,
        "success_rate": rate,
        "wilson95": list(wilson(successes, len(moved))),
        "cluster95": list(cluster_interval(*zip(*per_episode.values(), strict=True)) if moved else (0.0, 1.0)),
        "clearance": sum(e.parts_picked for e in episodes) / dropped if dropped else None,
        "no_picks": len(records) - len(moved),
        "reasons": dict(Counter(str(a.reason) for a in records if not a.success).most_common()),
        "ends": {end: sum(e.end == end for e in episodes) for end in ENDS},
        "cycle_s": cycle,
        "parts_left_per_episode": sum(e.parts_dropped - e.parts_picked for e in episodes) / len(episodes)
        if episodes
        else None,
        "picks_per_hour": _picks_per_hour(records),
        "wall_s": meta["wall_s"],
        "wall_per_attempt_s": sum(e.wall_s for e in episodes) / in_episodes if in_episodes else None,
        "record_hash": record_hash(records, episodes),
    }


def _picks_per_hour(records: Sequence[AttemptRecord]) -> float | None:
    """Successful picks an hour of cell time: cycles of the attempts, and the time in which the arm did not move."""
    moved = [a for a in records if a.moved]
    carried_out = [a for a in moved if a.reason != Reason.SIMULATION_ERROR]
    if not carried_out:
        return None
    mean_s = sum(a.cycle_s for a in carried_out) / len(carried_out)  # an attempt that broke down counts with the mean
    spent_s = mean_s * len(moved) + sum(a.cycle_s for a in records if not a.moved)
    return 3600 * sum(a.success for a in moved) / spent_s if spent_s else None


def _mean_cycle(attempts: Sequence[AttemptRecord]) -> dict[str, float | None]:
    if not attempts:
        return dict.fromkeys(("sensing", "compute", "robot", "total"))
    n = len(attempts)
    return {
        "sensing": sum(a.sensing_s for a in attempts) / n,
        "compute": sum(a.compute_s for a in attempts) / n,
        "robot": sum(a.robot_s for a in attempts) / n,
        "total": sum(a.cycle_s for a in attempts) / n,
    }


def leaves_parts(summary: dict[str, Any], attempt_limit: int, count: int) -> bool:
    """Clearance is below `CLEARANCE_WANTED`, and not because the stop rule ends an episode before the bin is empty."""
    return summary["clearance"] is not None and summary["clearance"] < CLEARANCE_WANTED and attempt_limit >= count


def write_summary(directory: Path, summary: dict[str, Any]) -> Path:
    """Write DIR/summary.json, whole or not at all."""
    return write_json(directory / FILE, summary)


def counted(n: int, what: str) -> str:
    """As "1 episode", "2 episodes"."""
    return f"{n} {what}" if n == 1 else f"{n} {what}s"


def percent(value: float | None, digits: int = 1) -> str:
    """A rate as text; a dash where there is none."""
    return "-" if value is None else f"{100 * value:.{digits}f} %"


def interval(bounds: Sequence[float]) -> str:
    """An interval of rates as text; its ends are rounded outwards."""
    low, high = floor(bounds[0] * 1000) / 10, ceil(bounds[1] * 1000) / 10
    return f"{low:.1f} to {min(high, 100.0):.1f} %"


def seconds(value: float | None) -> str:
    """A time in [s] as text; a dash where there is none."""
    return "-" if value is None else f"{value:.2f} s"


def print_summary(console: Console, summary: dict[str, Any]) -> None:
    """The table at the end of a run."""
    s = summary
    oracle = f", oracle: {' + '.join(s['oracle'])}" if s["oracle"] else ""
    episodes = counted(s["episodes"], "episode")
    table = Table(title=f"{s['scenario']}: {episodes} from seed {s['seed']}{oracle}", show_header=False)
    table.add_column(style="bold")
    table.add_column()
    table.add_row(
        "pick success", f"[bold]{percent(s['success_rate'])}[/]  {s['successes']} of {s['attempts']} attempts"
    )
    table.add_row("  95 %, picks of one bin correlated", interval(s["cluster95"]))
    table.add_row("  95 %, picks independent (Wilson)", interval(s["wilson95"]))
    table.add_row("clearance", f"{percent(s['clearance'])} of the workpieces dropped{_left(s)}")
    table.add_row("no-picks (arm not moved)", str(s["no_picks"]))
    table.add_row("failures and no-picks", counts(s["reasons"].items()))
    table.add_row("ends of episodes", counts(s["ends"].items()))
    cycle = s["cycle_s"]
    split = " + ".join(f"{name} {seconds(cycle[name])}" for name in ("sensing", "compute", "robot"))
    table.add_row("cycle", f"{seconds(cycle['total'])} = {split}")
    table.add_row("picks per hour", "-" if s["picks_per_hour"] is None else f"{s['picks_per_hour']:.0f}")
    table.add_row("wall time", f"{s['wall_s']:.0f} s, {seconds(s['wall_per_attempt_s'])} an attempt and core")
    table.add_row("record hash", s["record_hash"][:16])
    console.print(table)


def _left(summary: dict[str, Any]) -> str:
    left = summary["parts_left_per_episode"]
    return f"; {left:.1f} left a bin" if left else ""


def counts(items: Iterable[tuple[str, int]]) -> str:
    """As "dropped 3, missed 1"; what never happened is left out."""
    return ", ".join(f"{name} {count}" for name, count in items if count) or "none"
