"""Cameras from the files in which cameras, libraries and datasets describe them."""
