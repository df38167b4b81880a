"""Grasp points on the CAD become ranked grasp candidates, each with the reason that ruled it out."""

import cell  # noqa: F401  fixes the numeric profile before numpy is loaded
