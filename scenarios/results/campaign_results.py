"""The results of a campaign as a library: typed records, the summary, a table for pandas."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from pickproof.cell.errors import InputError
from pickproof.scenarios.results.columns import columns_of
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord
from pickproof.scenarios.results.store import Store
from pickproof.scenarios.results.summary import summarise

if TYPE_CHECKING:
    import pandas

FLAT = tuple(c.name for c in columns_of(AttemptRecord) if c.kind is not None)
"""What of an attempt is a single value."""


@dataclass(frozen=True)
class CampaignResults:
    """A campaign in a folder that `pickproof run` wrote or is writing; each property is read once, when asked for.

    It is a path too (`os.PathLike`): what takes a folder of results takes it.

    Attributes:
        directory: holds results.sqlite.
    """

    directory: Path

    @classmethod
    def open(cls, directory: str | os.PathLike[str]) -> Self:
        """The campaign in a folder.

        Raises:
            InputError: there are no results, or they are not pickproof's.
        """
        Store.read(Path(directory)).close()
        return cls(Path(directory))

    def __fspath__(self) -> str:
        """The folder."""
        return str(self.directory)

    @cached_property
    def attempts(self) -> tuple[AttemptRecord, ...]:
        """Attempts and no-picks in order of seed and attempt; `Store.pictures` has their pictures."""
        with Store.read(self.directory) as store:
            return tuple(store.attempts())

    @cached_property
    def episodes(self) -> tuple[EpisodeRecord, ...]:
        """Episodes that ended, in order of seed."""
        with Store.read(self.directory) as store:
            return tuple(store.episodes())

    @cached_property
    def meta(self) -> dict[str, Any]:
        """What was run: scenario, seed, oracle, hashes and versions."""
        with Store.read(self.directory) as store:
            return store.meta()

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The keys of summary.json (docs/reference/files.md), of what is there now."""
        with Store.read(self.directory) as store:
            return summarise(store)

    def to_frame(self) -> pandas.DataFrame:
        """One row an attempt: every field that is a single value, `compute_s`, `cycle_s`, and `end` of the episode.

        Raises:
            InputError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise InputError("Campaign.to_frame", "pandas", "missing", "pip install 'pickproof[data]'") from None
        with Store.read(self.directory) as store:
            return pandas.DataFrame(columns(store.attempts(large=False), store.episodes()))


def columns(attempts: Sequence[AttemptRecord], episodes: Sequence[EpisodeRecord]) -> dict[str, list[Any]]:
    """Name -> value of each attempt, for whatever is a single value."""
    ends = {e.seed: e.end for e in episodes}
    table: dict[str, list[Any]] = {name: [getattr(a, name) for a in attempts] for name in FLAT}
    table["reason"] = [str(reason) for reason in table["reason"]]
    return table | {
        "compute_s": [a.compute_s for a in attempts],
        "cycle_s": [a.cycle_s for a in attempts],
        "end": [ends.get(a.seed, "") for a in attempts],
    }
