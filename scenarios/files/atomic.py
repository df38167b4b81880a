"""Atomic writing of small files, and names of free folders."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pickproof.cell.errors import PickproofError


class StoreError(PickproofError):
    """Results cannot be read or written (locked, disk full, damaged)."""


def write_whole(path: Path, content: str | bytes) -> Path:
    """Write a file atomically, text as UTF-8; on an error the old content is kept.

    A link stays a link. A path that is not a regular file, such as /dev/null or a pipe, is written to and never
    replaced.

    Raises:
        StoreError: it cannot be written.
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        if path.exists() and not path.is_file():
            path.write_bytes(data)
            return path
        target = path.resolve()
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(target.name + ".partial")
        partial.write_bytes(data)
        partial.replace(target)
    except OSError as error:
        raise StoreError(f"{path}: cannot be written ({error.strerror})") from None
    return path


def write_json(path: Path, document: Any) -> Path:
    """Write a document atomically as indented JSON."""
    return write_whole(path, json.dumps(document, indent=2) + "\n")


def free_folder(directory: Path) -> Path:
    """`directory`, or the first of directory-2, directory-3, ... that does not exist."""
    candidate, n = directory, 1
    while candidate.exists():
        n += 1
        candidate = directory.with_name(f"{directory.name}-{n}")
    return candidate
