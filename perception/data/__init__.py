"""Scenes and images: settled heaps, BOP datasets, regions of interest, noise of an image."""
