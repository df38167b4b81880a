"""Boxes and bins, ray casting, nearest points, point files."""
