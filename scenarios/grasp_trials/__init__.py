"""Trials of grasps in the physics on a single workpiece."""
