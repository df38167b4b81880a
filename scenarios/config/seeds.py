"""The range of seeds."""

MAX_SEED = 2**31 - 1
"""Largest seed of an episode."""
