"""Depth images to workpiece poses: PS6D, refinement and verification. The only folder that imports torch."""
