"""Metrics, evaluation on held-out heaps, and the calibration of the score."""
