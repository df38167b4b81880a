"""The symmetry of a workpiece, how it is found in a mesh, and pose errors that respect it."""
