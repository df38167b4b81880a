"""The arm: its model, forward and inverse kinematics, and its links."""
