"""Confidence intervals and the sequential test."""
