"""Where true poses and labels are read: docs/explanation/pipeline.md names every file, and no other file does."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "explanation" / "pipeline.md"
CALLS = {"observe", "part_pose", "part_poses", "nearest_true"}
LABELS = {"ids"}


def reads_truth(source: str) -> bool:
    """Whether a module calls what gives true poses, or takes the labels of pixels."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call):
            called = node.func
            name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
            if name.lstrip("_") in CALLS:
                return True
        if isinstance(node, ast.Attribute) and node.attr in LABELS:
            return True
    return False


def named() -> list[str]:
    """Files and folders in the tables under `Where ground truth is read`."""
    section = PAGE.read_text().split("## Where ground truth is read")[1]
    return re.findall(r"^\| `([\w/.]+)` \|", section, re.MULTILINE)


def reading() -> set[str]:
    """Files of the rooms above the physics that read ground truth."""
    files = [path for room in ("scenarios", "perception", "grasping", "robots") for path in (ROOT / room).rglob("*.py")]
    return {str(path.relative_to(ROOT)) for path in files if reads_truth(path.read_text())}


def test_the_page_names_every_file_that_reads_ground_truth() -> None:
    folders = tuple(name for name in named() if name.endswith("/"))
    unnamed = sorted(file for file in reading() if file not in named() and not file.startswith(folders))
    assert not unnamed, f"name in {PAGE.relative_to(ROOT)} what these do with ground truth: {unnamed}"


def test_every_file_that_the_page_names_reads_ground_truth() -> None:
    read = reading()
    idle = [name for name in named() if name not in read and not any(file.startswith(name) for file in read)]
    assert not idle


def test_a_read_is_seen() -> None:
    assert reads_truth("truth = cell.observe()")
    assert reads_truth("seen = exact.ids >= 0")
    assert not reads_truth("depth = frame.depth; observed = frame.points()")
