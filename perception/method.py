"""The ways in which poses are found: `perception.method` of a scenario, `--method` of a command."""

from __future__ import annotations

from typing import Literal, get_args

Method = Literal["ps6d", "search", "both", "auto"]
"""ps6d: the trained network; search: without training; both: the network's poses beside those of the search; auto:
ps6d where the workpiece has weights, else search."""

METHODS: tuple[str, ...] = get_args(Method)
