"""Trajectories and their timing: joint moves, tool lines, blended motions, torque limits."""
