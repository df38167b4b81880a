"""Grasps tried in the physics on a lone workpiece."""
