"""Counts of verdicts over the trees of attempts."""

from __future__ import annotations

from collections import Counter
from sys import intern
from typing import Any

from pickproof.grasping.verdict import CHOSEN


def condensed(tree: Any) -> Any:
    """One estimate in place of all: the same number of poses by grasp point and verdict, and the chosen candidate.

    A thirtieth of the size, and all that is counted over many attempts.
    """
    if not isinstance(tree, list):
        return tree
    ruled_out: dict[str, dict[str, int]] = {}
    chosen = []
    for estimate in tree:
        counts = [(name, c.items()) for name, c in estimate.get("ruled_out", {}).items()]
        for candidate in estimate.get("candidates", ()):
            if candidate["verdict"] == CHOSEN:
                chosen.append(candidate)
            else:
                counts.append((candidate["grasp"], ((candidate["verdict"], 1),)))
        for name, of_point in counts:
            if (mine := ruled_out.get(name)) is None:
                mine = ruled_out[intern(name)] = {}
            for verdict, n in of_point:
                if verdict in mine:
                    mine[verdict] += n
                else:
                    mine[intern(verdict)] = n
    return [{"ruled_out": ruled_out, "candidates": chosen}]


def verdict_counts(tree: Any) -> Counter[str]:
    """How many grasp poses of a tree, or of one of its estimates, have each verdict."""
    counts: Counter[str] = Counter()
    for estimate in [tree] if isinstance(tree, dict) else tree or ():
        for of_point in estimate.get("ruled_out", {}).values():
            counts.update(of_point)
        counts.update(c["verdict"] for c in estimate.get("candidates", ()))
    return counts
