"""Search path of workpieces: folders of the user, then registered folders.

A workpiece is a folder with a workpiece.yaml; its name is that of the folder. Those of the user are listed in the
environment variable PICKPROOF_WORKPIECES; `import pickproof` registers the shipped ones.
"""

from __future__ import annotations

import os
from pathlib import Path

from pickproof.cell.child_process import FOLDERS

_registered: list[Path] = []


def register_folder(folder: Path) -> None:
    """Append a folder of workpiece folders to the search path; repeated calls have no effect."""
    if folder not in _registered:
        _registered.append(folder)


def search_path() -> list[Path]:
    """Folders that hold workpiece folders: those in PICKPROOF_WORKPIECES, then the registered ones."""
    extra = [Path(p) for p in os.environ.get(FOLDERS, "").split(os.pathsep) if p]
    return [*extra, *_registered]


def workpiece_folder(name: str) -> Path | None:
    """The first folder of a workpiece of this name on the search path; None where there is none."""
    return next((root / name for root in search_path() if (root / name / "workpiece.yaml").is_file()), None)


def list_workpieces() -> list[str]:
    """Names of all workpieces on the search path."""
    found = {p.parent.name for folder in search_path() for p in folder.glob("*/workpiece.yaml")}
    return sorted(found)
