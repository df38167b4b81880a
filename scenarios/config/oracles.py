"""The oracles: stages of a pick that ground truth can replace."""

from __future__ import annotations

from typing import Literal, get_args

Oracle = Literal["perception", "grasp", "motion"]
ORACLES: tuple[Oracle, ...] = get_args(Oracle)
"""Stages that ground truth can replace, in the order of a pick; docs/explanation/attribution.md defines each."""
