"""Where a run came from: the git commit of the program, and when it began."""

from __future__ import annotations

import subprocess
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parent


def provenance() -> dict[str, str]:
    """`commit`, with `+` if tracked files differ from it, empty outside a git checkout; `started`, UTC.

    Neither is part of a hash: a run can be resumed after a commit.
    """
    return {"commit": git_commit(ROOT), "started": datetime.now(UTC).isoformat(timespec="seconds")}


def git_commit(folder: Path) -> str:
    """The commit of the checkout that tracks the files of `folder`, 40 hexadecimal digits, with `+` if changed."""
    if not _git(folder, "ls-files", "--", "*.py"):  # installed inside the checkout of another project
        return ""
    commit = _git(folder, "rev-parse", "HEAD")
    return commit + "+" * bool(commit and _git(folder, "status", "--porcelain", "--untracked-files=no"))


def _git(folder: Path, *words: str) -> str:
    try:
        done = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.TimeoutExpired):  # git is missing or does not answer
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
