"""Symmetry of a workpiece: search in a mesh, and pose errors that respect it."""
