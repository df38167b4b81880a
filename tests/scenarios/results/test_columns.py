from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal

import numpy as np
import pytest

from pickproof.scenarios.results.columns import LARGE, OWN_TABLE, columns_of, values_of
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord


class Word(StrEnum):
    YES = "yes"


@dataclass(frozen=True)
class Example:
    whole: int
    flag: bool
    ratio: float | None
    word: Word | Literal[""]
    kind: Literal["a", "b"]
    matrix: tuple[tuple[float, ...], ...] | None = None
    tree: Any = field(default=None, metadata=LARGE)
    files: dict[str, bytes] = field(default_factory=dict, metadata=OWN_TABLE)


def test_columns_follow_from_the_fields():
    assert [c.sql for c in columns_of(Example)] == [
        "whole INTEGER NOT NULL",
        "flag INTEGER NOT NULL",
        "ratio REAL",
        "word TEXT NOT NULL",
        "kind TEXT NOT NULL",
        "matrix TEXT",
        "tree TEXT NOT NULL",
    ]
    assert [c.name for c in columns_of(Example) if c.large] == ["tree"]


@pytest.mark.parametrize("matrix", [None, ((1.0, 2.0),)])
@pytest.mark.parametrize("tree", [None, {"a": [1, None]}, [], float("inf")])
def test_values_come_back(matrix, tree):
    record = Example(3, True, None, Word.YES, "b", matrix, tree)
    row = {c.name: c.to_sql(getattr(record, c.name)) for c in columns_of(Example)}
    assert (row["tree"] is None, row["matrix"] is None) == (False, matrix is None)
    back = Example(**({"ratio": None} | values_of(Example, row)))
    assert (back.whole, back.flag, back.word, back.tree) == (3, True, "yes", tree)
    assert back.matrix == (None if matrix is None else [[1.0, 2.0]])


def test_numpy_in_a_tree_is_stored_as_numbers():
    tree = columns_of(Example)[-1]
    assert tree.from_sql(tree.to_sql({"at": np.arange(2), "n": np.int64(3)})) == {"at": [0, 1], "n": 3}


def test_every_field_of_the_records_has_a_place():
    """A type that the rule does not know is JSON; a path or a date would be stored as something else."""
    nested = {"estimate_T_world_part", "part_poses_after", "tree", "waypoints"}
    assert {c.name for c in columns_of(AttemptRecord) if c.kind is None} == nested
    assert all(c.kind is not None for c in columns_of(EpisodeRecord))
