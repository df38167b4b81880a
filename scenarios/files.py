"""Small files that are written whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from scenarios.store import StoreError


def write_whole(path: Path, text: str) -> Path:
    """Write a text file, or leave what was there.

    Raises:
        StoreError: it cannot be written.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        raise StoreError(f"{path}: cannot be written ({error.strerror})") from None
    return path


def write_json(path: Path, document: Any) -> Path:
    """Write a document as indented JSON, whole or not at all."""
    return write_whole(path, json.dumps(document, indent=2) + "\n")
