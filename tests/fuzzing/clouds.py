"""One small cloud in the formats that are read, and files of it that are cut, miscounted or in other units."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from pickproof.cell.errors import InputError
from pickproof.cell.geometry.point_file import read_point_file
from pickproof.cell.workpiece.workpiece import load_workpiece
from pickproof.perception.own_images.user_frame import Options, read_frame
from tests.fuzzing.mutate import GARBAGE

COUNT = 90
GAPS = 4
"""Points of a file that may be NaN."""


def points() -> np.ndarray:
    """(n, 3) [m] of an uneven surface before a camera."""
    rng = np.random.default_rng(7)
    xy = rng.uniform(-0.009, 0.009, (COUNT, 2))
    return np.round(np.column_stack([xy, 0.85 + 0.002 * np.sin(100 * xy[:, 0])]), 5)


def ply(values: np.ndarray, declared: int, binary: bool) -> bytes:
    kind = "binary_little_endian" if binary else "ascii"
    head = f"ply\nformat {kind} 1.0\nelement vertex {declared}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    return head.encode() + (values.astype("<f4").tobytes() if binary else text(values))


def pcd(values: np.ndarray, declared: int, binary: bool) -> bytes:
    head = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    head += f"WIDTH {declared}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {declared}\n"
    head += f"DATA {'binary' if binary else 'ascii'}\n"
    return head.encode() + (values.astype("<f4").tobytes() if binary else text(values))


def text(values: np.ndarray) -> bytes:
    return "".join(f"{x:.5f} {y:.5f} {z:.5f}\n" for x, y, z in values).encode()


def hostile(rng: np.random.Generator) -> tuple[str, bytes]:
    """Suffix and content of a cloud's file; some are in order."""
    suffix = str(rng.choice([".ply", ".pcd", ".pts", ".xyz"]))
    if rng.random() < 0.05:
        return suffix, rng.bytes(int(rng.integers(0, 300)))
    values, binary = points(), bool(rng.random() < 0.5)
    if rng.random() < 0.3:
        values[rng.choice(COUNT, GAPS, replace=False)] = np.nan
    if rng.random() < 0.1:
        values = 1000 * values
    declared = COUNT + int(rng.choice([0, 0, 0, 1, -3, 10**6, -COUNT - 5]))
    if suffix == ".ply":
        content = ply(values, declared, binary)
    elif suffix == ".pcd":
        content = pcd(values, declared, binary)
    else:
        binary = False
        content = (f"{declared}\n".encode() if suffix == ".pts" else b"") + text(values)
    kind = rng.random()
    if kind < 0.3 and declared >= COUNT:  # else the cut may fall where the smaller count says
        content = cut(content, suffix, binary, rng)
    elif kind < 0.4 and not binary:
        at = int(rng.integers(len(content)))
        content = content[:at] + GARBAGE[rng.integers(len(GARBAGE))] + content[at:]
    elif kind < 0.45 and suffix == ".pcd":
        content = content.replace(b"0 0 0 1 0 0 0", struct.pack("<7f", *rng.random(7)).hex().encode())
    return suffix, content


def cut(content: bytes, suffix: str, binary: bool, rng: np.random.Generator) -> bytes:
    """Up to some byte; text up to a whole number, since half of one cannot be told from a number.

    XYZ declares no count, so that it is cut within a line.
    """
    at = int(rng.integers(1, len(content)))
    if binary:
        return content[:at]
    if suffix == ".xyz":
        lines = content.splitlines(keepends=True)
        last = int(rng.integers(1, len(lines)))
        return b"".join(lines[:last]) + b" ".join(lines[last].split()[: rng.integers(1, 3)])
    at = max(content.rfind(b" ", 0, at), content.rfind(b"\n", 0, at), 0)
    return content[:at]


def check(path: Path) -> str:
    """`read` where a file gives the cloud in [m], `refused` where it gives a reason.

    Raises:
        AssertionError: other points, or other units.
    """
    try:
        found = read_point_file(path)
        frame = read_frame(path, Options(), load_workpiece("bracket"))
    except InputError as error:
        assert str(error).strip() and error.valid
        return "refused"
    gaps = np.linalg.norm(found[:, None] - points()[None], axis=-1)
    assert gaps.min(axis=1).max() < 1e-5, "read other points"
    assert (gaps < 1e-5).any(axis=0).sum() >= COUNT - GAPS, "points are missing"
    assert 0.8 < np.median(frame.depth[frame.depth > 0]) < 0.9, "another unit"
    return "read"
