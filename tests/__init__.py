"""Tests mirror the rooms; benchmarks and fuzzing stand beside them."""
