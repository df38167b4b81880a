"""Mesh files of users, read and checked in a process that has little memory and little time.

A file of a few kilobytes can ask its reader for any amount of memory (a glTF accessor, the header of a PLY), so the
reader is one that may be lost.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
from io import BytesIO
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from cell.errors import InputError
from cell.frames import Array
from cell.mesh_check import Checked, check_mesh
from cell.mesh_error import MeshError

FORMATS = ("stl", "obj", "ply", "glb", "step", "stp")
MEMORY = 2 * 2**30
"""[byte] of addresses that the reader may use."""
SECONDS = 60
"""[s] of processor time that it may use; on a busy machine it may take WAITS times as long."""
WAITS = 5
READABLE = "a readable " + ", ".join(f.upper() for f in FORMATS[:-1]) + " file"


def read_checked(path: Path, unit: str) -> Checked:
    """Read a mesh file in `unit`, repair it and say what was done; lengths become [m].

    Raises:
        InputError: no such file, another kind of file, or a mesh that cannot be made one closed solid.
    """
    kind = path.suffix.lower().removeprefix(".")
    if not path.is_file():
        raise InputError(path, "", "a folder" if path.is_dir() else "missing file", READABLE)
    if kind not in FORMATS:
        raise InputError(path, "", path.suffix or path.name, f"{READABLE}; archives are to be unpacked")
    if kind in ("step", "stp"):
        _check_step_reader(path)
    if path.stat().st_size > MEMORY // 4:
        raise InputError(path, "", f"{path.stat().st_size / 2**20:.0f} MiB", f"at most {MEMORY // 2**22} MiB")
    context = multiprocessing.get_context("spawn")
    mine, theirs = context.Pipe(duplex=False)
    reader = context.Process(target=_read, args=(theirs, str(path), kind, unit), daemon=True)
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


def _check_step_reader(path: Path) -> None:
    try:
        import cascadio  # noqa: F401
    except ImportError:
        valid = "another format, or `pip install pickproof[step]`, which reads STEP"
        raise InputError(path, "", path.suffix, valid) from None


def _read(out: Connection, path: str, kind: str, unit: str) -> None:
    """In the process that may be lost: send (vertices, faces, notes), or a MeshError."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    with open(os.devnull, "w") as nothing:  # noqa: PTH123  libraries of C++ write to the descriptor
        os.dup2(nothing.fileno(), 2)
        os.dup2(nothing.fileno(), 1)
    try:
        if kind in ("step", "stp"):
            unit = "m"  # such a file tells its own, and its reader converts
        checked = check_mesh(*_load(path, kind), unit)
        out.send((checked.vertices, checked.faces, checked.notes))
    except MeshError as error:
        out.send(error)
    except MemoryError:
        out.send(MeshError(f"a file that unfolds to more than {MEMORY / 2**30:.0f} GiB", "a smaller mesh"))
    except Exception as error:  # noqa: BLE001  readers raise whatever their parsers raise
        out.send(MeshError(" ".join(str(error).split())[:80] or type(error).__name__, READABLE))


def _load(path: str, kind: str) -> tuple[Array, np.ndarray]:
    """Vertices (n, 3) as they stand in the file, faces (m, 3); nothing but this file is read."""
    data = BytesIO(Path(path).read_bytes())
    if kind in ("step", "stp"):
        scene: Any = trimesh.load(data, file_type="step", force="scene")
    else:
        scene = trimesh.load(data, file_type=kind, force="scene", process=False, skip_materials=True)
    mesh = scene.to_mesh() if len(scene.geometry) else None
    if not isinstance(mesh, trimesh.Trimesh):
        raise MeshError("no faces", "a mesh with faces")
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
