"""The text of a camera's file as a mapping: JSON, YAML, and OpenCV's FileStorage in both."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from pickproof.cell.config import parse_yaml
from pickproof.cell.errors import InputError

FILE_STORAGE = re.compile(r":[ \t]*!!opencv-matrix\b")


def read_mapping(path: Path) -> dict[str, Any]:
    """The mapping that a file holds.

    Raises:
        InputError: missing, unreadable, of another format, or a key that stands twice.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(path, "", "missing file", "an existing JSON or YAML file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, "", str(error), "a readable UTF-8 JSON or YAML file") from None
    if text.lstrip().startswith("<"):
        valid = "JSON or YAML; OpenCV's FileStorage writes either, if the file is named so"
        raise InputError(path, "", "XML", valid)
    if text.lstrip().startswith("{"):
        try:
            return dict(json.loads(text, object_pairs_hook=lambda pairs: _unique(pairs, path)))
        except ValueError as error:
            # read as YAML, a stray comma in a number would leave half of it
            if path.suffix.lower() == ".json":
                raise InputError(path, "", str(error), "JSON") from None
        except RecursionError:
            raise InputError(path, "", "lists nested too deeply", "the intrinsics of a camera") from None
    if text.startswith("%YAML:"):  # as FileStorage writes it, which YAML's own readers refuse
        text = "#" + text
        text = re.sub(r"^---[ \t]*$", "", text, count=1, flags=re.MULTILINE)
    return parse_yaml(FILE_STORAGE.sub(":", text), path)


def _unique(pairs: list[tuple[str, Any]], path: Path) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise InputError(path, key, value, "a key that stands once")
        found[key] = value
    return found
