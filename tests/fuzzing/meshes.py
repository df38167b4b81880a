"""Mesh files that are whole, damaged or nonsense, and what a reader must make of each: a mesh, or one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.mesh.checked import as_trimesh
from pickproof.cell.mesh.read import read_checked_here
from tests.fuzzing.mesh_writers import VOLUME, WRITERS, random_solid

UNIT_ERROR = 500.0
"""Factor of volume that no damage to a few numbers makes, but that mm for cm, or inches for mm, does."""
WORDS = [
    b"nan", b"-inf", b"1e400", b"-1", b"0", b"99999999999", b"f", b"v", b"solid", b"endsolid", b"end_header", b"\0",
    b"#", b"\\\n", b"\n", b"_", b"element face 4000000000\n",
    b"property list float float x\n", b"/", b"\xff\xfe", b"1e-30",
]  # fmt: skip


def mesh_file(rng: np.random.Generator) -> tuple[str, bytes]:
    """Suffix and content of a whole file of VOLUME mm3."""
    suffix = str(rng.choice(list(WRITERS)))
    writers = WRITERS[suffix]
    return f".{suffix}", writers[rng.integers(len(writers))](random_solid(rng), rng)


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    """The beginning of a file."""
    return data[: rng.integers(len(data))]


def flip(data: bytes, rng: np.random.Generator) -> bytes:
    """One to four bytes are others."""
    made = bytearray(data)
    for i in rng.integers(len(data), size=rng.integers(1, 5)):
        made[i] = rng.integers(256)
    return bytes(made)


def insert(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes in between that were not there."""
    at = rng.integers(len(data) + 1)
    return data[:at] + rng.bytes(rng.integers(1, 60)) + data[at:]


def insert_word(data: bytes, rng: np.random.Generator) -> bytes:
    """A word of one of the formats, or a number that is none, at a space."""
    places = [i for i, byte in enumerate(data[:20_000]) if byte in b" \n"] or [0]
    at = places[rng.integers(len(places))]
    word = WORDS[rng.integers(len(WORDS))]
    return data[: at + 1] + word + b" " * int(rng.integers(2)) + data[at + 1 :]


def drop(data: bytes, rng: np.random.Generator) -> bytes:
    """A stretch is missing."""
    at = rng.integers(len(data))
    return data[:at] + data[at + rng.integers(1, 200) :]


def double(data: bytes, rng: np.random.Generator) -> bytes:
    """A stretch is there twice."""
    at = rng.integers(len(data))
    piece = data[at : at + rng.integers(1, 200)]
    return data[:at] + piece + data[at:]


def noise(data: bytes, rng: np.random.Generator) -> bytes:
    """The first bytes of a file, and then anything."""
    return data[: rng.integers(200)] + rng.bytes(rng.integers(400))


DAMAGE: list[Callable[[bytes, np.random.Generator], bytes]] = [cut, flip, insert, insert_word, drop, double, noise]


def hostile_mesh(rng: np.random.Generator) -> tuple[str, bytes]:
    """Suffix and content of a file; one in eight is whole, one in twenty carries the suffix of another format."""
    suffix, data = mesh_file(rng)
    if rng.random() > 1 / 8:
        for _ in range(int(rng.integers(1, 3))):
            data = DAMAGE[rng.integers(len(DAMAGE))](data, rng) if data else data
    if rng.random() < 1 / 20:
        suffix = f".{rng.choice(list(WRITERS))}"
    return suffix, data


def check_mesh_file(path: Path) -> str:
    """`read` or `refused`, in this process.

    Raises:
        AssertionError: another exception than InputError, more than one line, or a volume that is off as by a unit.
    """
    try:
        mesh = as_trimesh(read_checked_here(path, "mm"))
    except InputError as error:
        assert "\n" not in str(error) and str(error).startswith(str(path)), f"{path}: {error}"
        return "refused"
    except Exception as error:
        raise AssertionError(f"{path}: {type(error).__name__}: {error}") from error
    factor = mesh.volume * 1e9 / VOLUME
    assert 1 / UNIT_ERROR < factor < UNIT_ERROR, f"{path}: the volume is {factor:.3g} times that of the solid"
    return "read"
