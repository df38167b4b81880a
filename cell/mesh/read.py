"""Mesh files of users, read and checked in a process that has little memory and little time.

A file of a few kilobytes can ask its reader for any amount of memory (a glTF accessor, the header of a PLY), so the
reader is one that may be lost.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
from multiprocessing.connection import Connection
from pathlib import Path

from pickproof.cell.errors import InputError
from pickproof.cell.mesh.check import check_mesh
from pickproof.cell.mesh.checked import Checked
from pickproof.cell.mesh.error import MeshError
from pickproof.cell.mesh.file import READERS, kind_of, read_mesh

FORMATS = tuple(READERS)
MEMORY = 2 * 2**30
"""[byte] of addresses that the reader may use."""
SECONDS = 60
"""[s] of processor time that it may use; on a busy machine it may take WAITS times as long."""
WAITS = 5
READABLE = "a readable " + ", ".join(f.upper() for f in FORMATS[:-1]) + " file"


def read_checked(path: Path, unit: str, body: int | None = None) -> Checked:
    """Read a mesh file in `unit`, repair it and say what was done; lengths become [m].

    Args:
        body: which of several bodies that do not touch is meant, 1 for the largest.

    Raises:
        InputError: no such file, another kind of file, or a mesh that cannot be made one closed solid.
    """
    _check_path(path)
    context = multiprocessing.get_context("spawn")
    mine, theirs = context.Pipe(duplex=False)
    reader = context.Process(target=_read, args=(theirs, path, unit, body), daemon=True)
    reader.start()
    theirs.close()
    slow = MeshError(f"not read after {SECONDS} s", "a smaller mesh")
    try:
        answer = mine.recv() if mine.poll(WAITS * SECONDS) else slow
    except EOFError:  # killed, or crashed in a library
        reader.join()
        broken = MeshError("a file on which its reader broke down", READABLE)
        answer = slow if reader.exitcode == -signal.SIGXCPU else broken
    finally:
        reader.kill()
        reader.join()
        mine.close()
    if isinstance(answer, MeshError):
        raise InputError(path, "", answer.found, answer.valid)
    return Checked(*answer)


def read_checked_here(path: Path, unit: str, body: int | None = None) -> Checked:
    """The same as `read_checked` in this process, without its limits of memory and time.

    Raises:
        InputError: as there.
    """
    _check_path(path)
    try:
        return _understood(path, unit, body)
    except MeshError as error:
        raise InputError(path, "", error.found, error.valid) from None


def _check_path(path: Path) -> None:
    kind = kind_of(path)
    if not path.is_file():
        raise InputError(path, "", "a folder" if path.is_dir() else "missing file", READABLE)
    if kind not in FORMATS:
        raise InputError(path, "", path.suffix or path.name, f"{READABLE}; archives are to be unpacked")
    if kind in ("step", "stp"):
        _check_step_reader(path)
    if path.stat().st_size > MEMORY // 4:
        raise InputError(path, "", f"{path.stat().st_size / 2**20:.0f} MiB", f"at most {MEMORY // 2**22} MiB")


def _check_step_reader(path: Path) -> None:
    try:
        import cascadio  # noqa: F401
    except ImportError:
        valid = "another format, or `pip install pickproof[step]`, which reads STEP"
        raise InputError(path, "", path.suffix, valid) from None


def _understood(path: Path, unit: str, body: int | None) -> Checked:
    raw = read_mesh(path)
    if kind_of(path) in ("step", "stp"):
        unit = "m"  # such a file tells its own, and its reader converts
    checked = check_mesh(raw.vertices, raw.faces, unit, body)
    checked.notes[:0] = raw.notes
    return checked


def _read(out: Connection, path: Path, unit: str, body: int | None) -> None:
    """In the process that may be lost: send the fields of Checked in order, or a MeshError."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    with open(os.devnull, "w") as nothing:  # noqa: PTH123  libraries of C++ write to the descriptor
        os.dup2(nothing.fileno(), 2)
        os.dup2(nothing.fileno(), 1)
    try:
        checked = _understood(path, unit, body)
        out.send((checked.vertices, checked.faces, checked.notes, checked.volume_change, checked.moved))
    except MeshError as error:
        out.send(error)
    except MemoryError:
        out.send(MeshError(f"a file that unfolds to more than {MEMORY / 2**30:.0f} GiB", "a smaller mesh"))
    except Exception as error:  # noqa: BLE001  a fault of ours must not become a traceback of the user's
        out.send(MeshError(" ".join(str(error).split())[:80] or type(error).__name__, READABLE))
