"""Changes of a document that a user's mistake, a broken writer or an attack can make."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

HOSTILE: tuple[Any, ...] = (
    *(None, "", "text", "12", "1e9", True, False, 0, -1, 1e308, -1e308, 10**400, 10**30, 2**63),
    *(float("nan"), float("inf"), [], {}, [[]], [[[1]]], {"data": []}, {"data": {"data": 1}}, [None], ["a", "b"]),
)
GARBAGE = (b"\x00", b"\xff", b"{", b"}", b"[", b":", b",", b"\t", b"\n", b"&", b"*", b"!", b"#", b"'", b'"', b"%", b"|")


def leaves(document: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths to every value that is neither a mapping nor a list."""
    if isinstance(document, dict):
        return [leaf for key, value in document.items() for leaf in leaves(value, (*path, key))]
    if isinstance(document, list):
        return [leaf for i, value in enumerate(document) for leaf in leaves(value, (*path, i))]
    return [path]


def holder(document: Any, path: tuple[Any, ...]) -> Any:
    """The mapping or list in which the last key of a path stands."""
    for key in path[:-1]:
        document = document[key]
    return document


def mutated(document: dict[str, Any], rng: np.random.Generator, whole: tuple[str, ...] = ()) -> dict[str, Any]:
    """A copy with one value replaced, scaled, dropped, renamed or wrapped.

    Args:
        whole: keys of poses, whose numbers change all together: one alone cannot be told from a number of another pose.
    """
    document = copy.deepcopy(document)
    paths = leaves(document)
    if not paths:
        return document
    path = paths[rng.integers(len(paths))]
    path = path[: rng.integers(1, len(path) + 1)] if rng.random() < 0.4 else path
    is_pose = any(key in whole for key in path)
    if is_pose:
        path = path[: next(i for i, key in enumerate(path) if key in whole) + 1]
    inside, key = holder(document, path), path[-1]
    value = inside[key]
    kind = rng.integers(7)
    if kind == 0:
        inside[key] = copy.deepcopy(HOSTILE[rng.integers(len(HOSTILE))])
    elif kind == 1:
        inside[key] = scaled(value, float(rng.choice([1000.0, 0.001] if is_pose else [1000.0, 0.001, -1.0])))
    elif kind == 2:
        del inside[key]
    elif kind == 3 and isinstance(inside, dict):
        inside[f"{key}_x"] = inside.pop(key)
    elif kind == 4:
        inside[key] = [value] if rng.random() < 0.5 else {"value": value}
    elif kind == 5:
        inside[key] = str(value)
    elif isinstance(inside, dict):
        inside[str(rng.choice(["extra", "offset", "k9", "unit"]))] = copy.deepcopy(HOSTILE[rng.integers(len(HOSTILE))])
    return document


def scaled(value: Any, by: float) -> Any:
    """Every number of a value times `by`."""
    if isinstance(value, list):
        return [scaled(entry, by) for entry in value]
    if isinstance(value, dict):
        return {key: scaled(entry, by) for key, entry in value.items()}
    if isinstance(value, bool) or not isinstance(value, (int, float)) or abs(value) > 1e300:
        return value
    return by * value


def with_garbage(content: bytes, rng: np.random.Generator) -> bytes:
    """A character that is no part of a number, somewhere."""
    at = int(rng.integers(len(content) + 1))
    return content[:at] + GARBAGE[rng.integers(len(GARBAGE))] + content[at:]
