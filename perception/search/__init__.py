"""Poses of any CAD part in a depth image without training: exhaustive search, registration, two decisions."""
