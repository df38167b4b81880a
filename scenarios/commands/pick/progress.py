"""Progress of a campaign in the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from types import TracebackType

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

from pickproof.scenarios.campaign.executor import Event
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord
from pickproof.scenarios.results.summary import counted, counts, interval, percent
from pickproof.scenarios.statistics.intervals import wilson

MEMORY_S = 3600.0
"""Time span [s] from which the remaining time is estimated: an episode takes minutes."""


class CampaignProgress:
    """Progress of a campaign in the terminal; pass `update` to the campaign. Without a terminal, one line per episode.

    Args:
        total: number of episodes of the campaign; done: records that existed at the start, when resumed.
        parts: workpieces an episode drops.
    """

    def __init__(self, console: Console, total: int, parts: int, done: Sequence[AttemptRecord] = ()) -> None:
        self._console, self._total, self._parts = console, total, parts
        self._of_seed: dict[int, list[AttemptRecord]] = {}
        self._ended: dict[int, EpisodeRecord] = {}
        for a in done:
            self._of_seed.setdefault(a.seed, []).append(a)
        self._before = len(self._of_seed)
        self._bar = _Bar(
            BarColumn(bar_width=None),
            TextColumn("{task.description}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
            speed_estimate_period=MEMORY_S,
        )
        self._task = self._bar.add_task(self._so_far(), total=total, completed=self._before)

    def __enter__(self) -> CampaignProgress:
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, tb: TracebackType | None) -> None:
        self._bar.stop()

    def update(self, event: Event) -> None:
        """Show an event."""
        mine = self._of_seed.setdefault(event.seed, [])
        if event.attempt is not None:
            mine.append(event.attempt)
        elif event.episode is not None:
            e = self._ended[event.seed] = event.episode
            tried = sum(a.moved for a in mine)
            line = (
                f"episode {e.seed}: {e.end}, {e.parts_picked} of {e.parts_dropped} picked in {tried} attempts, "
                f"{e.wall_s:.0f} s"
            )
            # without a terminal, these lines are the only progress
            self._console.print(line if self._console.is_terminal else f"{line}; {self._so_far()}", soft_wrap=True)
        else:
            mine.clear()
            self._console.print(f"episode {event.seed}: its worker crashed or hung; the episode is repeated")
        self._bar.update(self._task, completed=self._finished(), description=self._so_far())
        self._bar.below = rates([a for of_one in self._of_seed.values() for a in of_one])

    def _finished(self) -> float:
        """Ended episodes; a running one counts by its share of picked workpieces."""
        running = sum(
            min(0.95, sum(a.success for a in mine) / self._parts)
            for seed, mine in list(self._of_seed.items())[self._before :]
            if seed not in self._ended
        )
        return self._before + len(self._ended) + running

    def _so_far(self) -> str:
        return f"{self._before + len(self._ended)} of {counted(self._total, 'episode')}"


class _Bar(Progress):
    """rich's progress display with lines below it."""

    below: tuple[Text, ...] = ()

    def get_renderables(self) -> Iterable[RenderableType]:
        """The parts of rich's display, then the lines."""
        yield from super().get_renderables()
        yield from self.below


def rates(records: Sequence[AttemptRecord]) -> tuple[Text, Text]:
    """The pick success rate with its interval, and how often each reason of a failure occurred."""
    moved, good = sum(a.moved for a in records), sum(a.success for a in records)
    rate = percent(good / moved) if moved else "-"
    reasons = Counter(str(a.reason) for a in records if not a.success)
    return (
        Text(f"pick success {rate}  ({good} of {moved}; 95 % Wilson {interval(wilson(good, moved))})", style="bold"),
        Text(f"failures and no-picks: {counts(reasons.most_common())}"),
    )
