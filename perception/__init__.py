"""Depth images to workpiece poses: PS6D, refinement and verification. The only folder that imports torch."""

import cell  # noqa: F401  fixes the numeric profile before numpy is loaded
