"""Connections to the results file: one writer, readers also where the folder is not writable, errors in one line."""

from __future__ import annotations

import fcntl
import os
import sqlite3
from pathlib import Path

from pickproof.cell.errors import InputError, PickproofError
from pickproof.scenarios.files.atomic import StoreError

_REFUSED = (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM)
_PATIENCE_S = 30.0  # [s] a writer waits for another program that holds the file


def connect(path: Path, mode: str) -> sqlite3.Connection:
    """Open the file with one of SQLite's modes (`rwc`, `rw`, `ro`).

    Raises:
        StoreError, InputError: see `explained`.
    """
    try:
        return sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", uri=True, timeout=_PATIENCE_S)
    except sqlite3.Error as error:
        raise explained(path, error) from None


def connect_to_read(path: Path) -> sqlite3.Connection:
    """A connection that reads, also where SQLite may not make the files beside the database that its WAL mode needs.

    There the file is read as one that never changes, unless a journal beside it holds what it lacks.

    Raises:
        InputError: the file may not be read.
        StoreError: there is such a journal.
    """
    if not os.access(path, os.R_OK):
        raise InputError(path, "", "no permission to read it", "a file that you may read")
    connection = connect(path, "ro")
    try:
        connection.execute("PRAGMA application_id").fetchone()
    except sqlite3.Error as error:
        refused = getattr(error, "sqlite_errorcode", 0) & 0xFF in _REFUSED
        if not refused or os.access(path.parent, os.W_OK):
            return connection  # what is read next says what is wrong
    else:
        return connection
    connection.close()
    for journal in (path.with_name(f"{path.name}{end}") for end in ("-wal", "-journal")):
        if journal.is_file() and journal.stat().st_size:
            found = f"holds what {path.name} lacks, and the folder is not writable"
            raise StoreError(f"{journal}: {found}; copy the folder to a place where you may write, and read it there")
    return connect(path, "ro&immutable=1")


def lock(directory: Path) -> int:
    """The handle of an advisory lock on the folder, given up by the system when the process ends.

    Raises:
        StoreError: another process writes there.
    """
    handle = os.open(directory, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        raise StoreError(f"{directory}: locked; another `pickproof run` is writing there") from None
    return handle


def explained(path: Path, error: sqlite3.Error) -> PickproofError:
    """What an error of SQLite means for the user, and what to do."""
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    if code in (sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_CORRUPT):
        return InputError(path, "", str(error), "a file that `pickproof run` wrote")
    if code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
        return StoreError(f"{path}: {error}; attempts up to here are kept, make room and continue with --resume")
    if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return StoreError(f"{path}: {error}; another program holds it, continue with --resume when it has let go")
    return StoreError(f"{path}: {error}")
