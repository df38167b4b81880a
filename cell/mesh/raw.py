"""A mesh as it stands in a file, and what the readers of all formats say of a file that is not whole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickproof.cell.frames import Array
from pickproof.cell.mesh.error import MeshError

PADDING = b"\0 \t\r\n"
"""What may follow the end of a mesh: zeros and white space say nothing."""


@dataclass(frozen=True)
class RawMesh:
    """Vertices (n, 3) in the file's unit, triangles (m, 3) as indices of them, and what was passed over in words."""

    vertices: Array
    faces: np.ndarray
    notes: tuple[str, ...] = ()


def cut_short(found: int, declared: int, what: str) -> MeshError:
    """The refusal of a file that holds less than its header declares."""
    return MeshError(f"{found} of {declared} declared {what}: the file was cut short", "all of them; export it again")


def padding(rest: bytes, declared: str) -> tuple[str, ...]:
    """The note on what follows the declared content, empty where nothing does.

    Raises:
        MeshError: more follows than zeros and white space, so the declared counts are doubtful.
    """
    if not rest:
        return ()
    if rest.strip(PADDING):
        raise MeshError(f"{len(rest)} bytes after the {declared}", "a file that ends with what it declares")
    return (f"passed over {len(rest)} bytes of padding at the end",)


def check_corners(corners: np.ndarray, sizes: np.ndarray, vertices: int) -> None:
    """Refuse faces with corners that are no vertices.

    Raises:
        MeshError: it names the first such face, counted from 1.
    """
    bad = (corners < 0) | (corners >= vertices)
    if bad.any():
        first = int(np.argmax(bad))
        face = int(np.searchsorted(np.cumsum(sizes), first, side="right"))
        raise MeshError(
            f"face {face + 1} with vertex {int(corners[first])} (counted from 0) of {vertices}",
            "a file whose faces use its own vertices; export it again",
        )
