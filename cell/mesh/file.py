"""The one reader of users' meshes: each format with a check of what the file declares of itself."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pickproof.cell.mesh.error import MeshError
from pickproof.cell.mesh.glb import read_glb, read_step
from pickproof.cell.mesh.obj import read_obj
from pickproof.cell.mesh.ply import read_ply
from pickproof.cell.mesh.raw import RawMesh
from pickproof.cell.mesh.stl import read_stl

READERS: dict[str, Callable[[bytes], RawMesh]] = {
    "stl": read_stl,
    "obj": read_obj,
    "ply": read_ply,
    "glb": read_glb,
    "step": read_step,
    "stp": read_step,
}


def kind_of(path: Path) -> str:
    """The format that a name tells."""
    return path.suffix.lower().removeprefix(".")


def read_mesh(path: Path) -> RawMesh:
    """A mesh as it stands in the file; nothing but this file is read.

    Raises:
        MeshError: it is not of its format, cut short, or does not hold what it declares.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise MeshError(str(error.strerror), "a file that can be read") from None
    return READERS[kind_of(path)](data)
