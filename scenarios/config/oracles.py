"""The oracles: stages of a pick that ground truth can replace."""

from __future__ import annotations

ORACLES = ("perception", "grasp", "motion")
"""Stages that ground truth can replace, in the order of a pick; docs/explanation/attribution.md defines each."""
