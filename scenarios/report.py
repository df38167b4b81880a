"""`pickproof report DIR`: one self-contained HTML page, no script, no network."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cell.page import page_template, png_uri
from grasping.verdict import CHOSEN, Verdict
from grasping.verdict import MEANING as VERDICTS
from scenarios.files import StoreError
from scenarios.records import NO_PICK_REASONS, AttemptRecord, Reason
from scenarios.statistics import wilson
from scenarios.store import Store
from scenarios.summary import interval, percent, seconds, summarise
from scenarios.tree import verdict_counts

FILE = "report.html"
PICTURE_BYTES = 3_500_000
"""Pictures are embedded up to this size in all, before base64 makes them a third larger."""
SUCCESSES_SHOWN = 4
ROWS_SHOWN = 2000
FILL_STEPS = 6

MEANING = {
    Reason.NO_DETECTION: "no workpiece was found that could be verified",
    Reason.WRONG_POSE: "the estimate was outside tolerance of every workpiece",
    Reason.ALL_GRASPS_BLOCKED: "no grasp left room for the gripper",
    Reason.NO_PLACE: "no free grasp allows the wanted place; it takes a regrasp",
    Reason.UNREACHABLE: "no free grasp was within the arm's reach",
    Reason.NO_PATH: "no motion without collision was found",
    Reason.COLLISION: "arm or gripper touched something too hard",
    Reason.MISSED: "the gripper closed on nothing",
    Reason.SLIPPED: "lost while lifting",
    Reason.DROPPED: "lost on the way to the place bin",
    Reason.DOUBLE_PICK: "more than one workpiece came along",
    Reason.MISPLACED: "not at rest in the place bin, or out of tolerance",
    Reason.EJECTED: "another workpiece left the bin",
    Reason.TIMEOUT: "took longer than the scenario allows",
    Reason.SIMULATION_ERROR: "the simulation broke down",
}


@dataclass(frozen=True)
class Share:
    """A count with its rate and Wilson interval, as a row of a table or a bar."""

    label: str
    good: int
    n: int

    @property
    def rate(self) -> float:
        return self.good / self.n if self.n else 0.0

    @property
    def bounds(self) -> tuple[float, float]:
        return wilson(self.good, self.n)


@dataclass(frozen=True)
class Shown:
    """An attempt with its pictures as data URIs."""

    attempt: AttemptRecord
    pictures: list[tuple[str, str]]


def write_report(directory: Path) -> Path:
    """Write DIR/report.html from DIR/results.sqlite; a campaign that was interrupted, or still runs, will do.

    Raises:
        InputError, StoreError: the results cannot be read, or the page cannot be written.
    """
    with Store.read(directory) as store:
        page = _render(store, directory)
    path = directory / FILE
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise StoreError(f"{path}: cannot be written ({error.strerror})") from None
    return path


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


def grasp_points(attempts: Sequence[AttemptRecord]) -> list[Share]:
    """Success of each grasp point, most used first."""
    used = Counter(a.grasp or "(none)" for a in attempts if a.moved)
    good = Counter(a.grasp or "(none)" for a in attempts if a.success)
    return [Share(name, good[name], n) for name, n in used.most_common()]


def verdict_rows(attempts: Sequence[AttemptRecord]) -> list[tuple[Verdict, int, float, str]]:
    """Verdict, grasp poses that it ruled out, their share of all, and what it means; none without trees."""
    counts: Counter[str] = Counter()
    for attempt in attempts:
        counts.update(verdict_counts(attempt.tree) if isinstance(attempt.tree, list) else {})
    total = sum(counts.values())
    return [(v, counts[v], counts[v] / total, VERDICTS[v]) for v in Verdict if counts[v]]


def choose_shown(store: Store, attempts: Sequence[AttemptRecord], budget: int = PICTURE_BYTES) -> list[Shown]:
    """Failures first, then no-picks, then successes spread over the campaign, while their pictures fit `budget`."""
    failed = [a for a in attempts if a.moved and not a.success]
    idle = [a for a in attempts if not a.moved]
    good = [a for a in attempts if a.success]
    spread = good[:: max(1, len(good) // SUCCESSES_SHOWN)][:SUCCESSES_SHOWN] if good else []
    # some room is kept for successes, so that a bad campaign still shows what a good pick looks like
    shown, left = _embed(store, spread[:2], budget // 4)
    first, left = _embed(store, failed, budget - budget // 4 + left)
    between, left = _embed(store, idle[:SUCCESSES_SHOWN], left)
    last, _ = _embed(store, spread[2:], left)
    return first + between + shown + last


def _embed(store: Store, attempts: Sequence[AttemptRecord], budget: int) -> tuple[list[Shown], int]:
    shown = []
    for a in attempts:
        pictures = store.pictures(a.seed, a.attempt)
        size = sum(len(png) for png in pictures.values())
        if not pictures or size > budget:
            continue
        budget -= size
        uris = [(n, png_uri(png)) for n, png in pictures.items()]
        shown.append(Shown(a, uris))
    return shown, budget


def _render(store: Store, directory: Path) -> str:
    summary, meta, attempts = summarise(store), store.meta(), store.attempts()
    moved = [a for a in attempts if a.moved]
    no_picks = {str(r) for r in NO_PICK_REASONS}
    reasons = [(r, n, r in no_picks) for r, n in summary["reasons"].items()]
    shown = choose_shown(store, attempts)
    template = page_template(
        "scenarios", "report.html.j2", percent=percent, interval=interval, seconds=seconds, readable=_readable
    )
    return template.render(
        s=summary,
        meta=meta,
        directory=directory,
        unfinished=meta["episodes"] - summary["episodes"],
        reasons=reasons,
        most=max((n for _, n, _ in reasons), default=1),
        meaning={str(k): v for k, v in MEANING.items()},
        fill=fill_levels(attempts),
        grasps=grasp_points(attempts),
        verdicts=verdict_rows(attempts),
        verdicts_of=lambda a: ", ".join(f"{n} {v}" for v, n in verdict_counts(a.tree).most_common() if v != CHOSEN),
        shown=shown,
        failures=sum(not a.success for a in moved),
        failures_shown=sum(x.attempt.moved and not x.attempt.success for x in shown),
        attempts=attempts[:ROWS_SHOWN],
        omitted=max(0, len(attempts) - ROWS_SHOWN),
        episodes=store.episodes(),
        accuracy=_accuracy(moved),
        scenario=json.dumps(json.loads(meta["scenario"]), indent=2),
    )


def _accuracy(attempts: Sequence[AttemptRecord]) -> dict[str, float] | None:
    """Medians of the chosen estimates' errors, in [mm] and [deg]."""
    pairs = sorted((a.error_mm, a.error_deg) for a in attempts if a.error_mm is not None and a.error_deg is not None)
    if not pairs:
        return None
    return {"mm": pairs[len(pairs) // 2][0], "deg": sorted(d for _, d in pairs)[len(pairs) // 2]}


def _readable(value: Any) -> str:
    return str(value).replace("_", " ")
