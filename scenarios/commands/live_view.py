"""Progress of a campaign in the terminal."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from types import TracebackType

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.text import Text

from pickproof.scenarios.campaign.executor import Event
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord
from pickproof.scenarios.results.summary import counted, counts, interval, percent
from pickproof.scenarios.statistics.intervals import wilson


class LiveView:
    """Progress of a campaign in the terminal; give `update` to the campaign. A line an episode where no terminal is.

    Args:
        total: episodes that the campaign has in all; done: records that it began with, when resumed.
        parts: workpieces an episode drops.
    """

    def __init__(self, console: Console, total: int, parts: int, done: Sequence[AttemptRecord] = ()) -> None:
        self._console, self._total, self._parts = console, total, parts
        self._of_seed: dict[int, list[AttemptRecord]] = {}
        self._ended: dict[int, EpisodeRecord] = {}
        self._begun = time.monotonic()
        for a in done:
            self._of_seed.setdefault(a.seed, []).append(a)
        self._before = len(self._of_seed)
        self._live = Live(console=console, refresh_per_second=2, transient=True, get_renderable=self.render)

    def __enter__(self) -> LiveView:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, tb: TracebackType | None) -> None:
        if self._console.is_terminal:
            self._live.stop()

    def update(self, event: Event) -> None:
        """Take note of an event."""
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
            # where there is no terminal, the lines are all the progress that one sees
            self._console.print(line if self._console.is_terminal else f"{line}; {self._so_far()}", soft_wrap=True)
        else:
            mine.clear()
            self._console.print(f"episode {event.seed}: its worker died or hung, run again")

    def render(self) -> Group:
        """Progress, time left, rate and reasons."""
        records = [a for mine in list(self._of_seed.values()) for a in list(mine)]
        moved, good = sum(a.moved for a in records), sum(a.success for a in records)
        rate = percent(good / moved) if moved else "-"
        rates = f"pick success {rate}  ({good} of {moved}; 95 % Wilson {interval(wilson(good, moved))})"
        reasons = Counter(str(a.reason) for a in records if not a.success)
        bar = ProgressBar(total=self._total, completed=self._finished(), width=60)
        return Group(
            bar,
            Text(self._so_far()),
            Text(rates, style="bold"),
            Text(f"failures and no-picks: {counts(reasons.most_common())}"),
        )

    def _finished(self) -> float:
        """Episodes that ended; one that runs counts by the share of its workpieces that are out."""
        running = sum(
            min(0.95, sum(a.success for a in list(mine)) / self._parts)
            for seed, mine in list(self._of_seed.items())[self._before :]
            if seed not in self._ended
        )
        return self._before + len(self._ended) + running

    def _so_far(self) -> str:
        return f"{self._before + len(self._ended)} of {counted(self._total, 'episode')}, {self._left(self._finished())}"

    def _left(self, finished: float) -> str:
        elapsed, share = time.monotonic() - self._begun, finished - self._before
        if share < 0.05:
            return f"{elapsed:.0f} s, time left not known yet"
        left = elapsed / share * (self._total - finished)
        return f"{elapsed:.0f} s, about {left // 60:.0f} min {left % 60:.0f} s left"
