"""Paths of the shipped files; imports nothing of the project, so that `import pickproof` can use it."""

from __future__ import annotations

from pathlib import Path

WORKPIECES = Path(__file__).resolve().parents[1] / "workpieces"
"""Folder of the shipped workpieces."""
