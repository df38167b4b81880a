"""The results file: DIR/results.sqlite, one writer, every attempt committed as it ends."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import sqlite3
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from pickproof.cell.errors import InputError, PickproofError
from pickproof.scenarios.files.atomic import StoreError
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord

FILE = "results.sqlite"
SCHEMA_VERSION = 2
APPLICATION_ID = 0x7069636B  # "pick", in the file's header

_TABLES = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE episodes (
    seed INTEGER PRIMARY KEY, parts_dropped INTEGER NOT NULL, parts_picked INTEGER NOT NULL, end TEXT NOT NULL,
    attempts INTEGER NOT NULL, wall_s REAL NOT NULL);
CREATE TABLE attempts (
    seed INTEGER NOT NULL, attempt INTEGER NOT NULL, moved INTEGER NOT NULL, success INTEGER NOT NULL,
    reason TEXT NOT NULL, parts_in_bin_before INTEGER NOT NULL, n_estimates INTEGER NOT NULL,
    estimate_T_world_part TEXT, estimate_score REAL, error_mm REAL, error_deg REAL, grasp TEXT NOT NULL,
    sensing_s REAL NOT NULL, perceive_s REAL NOT NULL, choose_s REAL NOT NULL, plan_s REAL NOT NULL,
    robot_s REAL NOT NULL, part_poses_after TEXT NOT NULL, tree TEXT NOT NULL, wall_s REAL NOT NULL,
    place_mm REAL, place_deg REAL, waypoints TEXT,
    PRIMARY KEY (seed, attempt));
CREATE TABLE pictures (
    seed INTEGER NOT NULL, attempt INTEGER NOT NULL, name TEXT NOT NULL, png BLOB NOT NULL,
    PRIMARY KEY (seed, attempt, name));
"""
_ATTEMPT_COLUMNS = [f.name for f in fields(AttemptRecord) if f.name != "pictures"]
_JSON_COLUMNS = ("estimate_T_world_part", "part_poses_after", "tree", "waypoints")
_EPISODE_COLUMNS = [f.name for f in fields(EpisodeRecord)]
LARGE_COLUMNS = ("tree", "waypoints")
_ADDED_COLUMNS = {"place_mm": "REAL", "place_deg": "REAL", "waypoints": "TEXT"}  # that version 1 did not know
_REFUSED = (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM)
_PATIENCE_S = 30.0  # [s] a writer waits for another program that holds the file


class Store:
    """An open results file. `create` and `resume` write, `read` only reads; use it as a context manager."""

    def __init__(self, path: Path, connection: sqlite3.Connection, lock: int | None = None) -> None:
        self.path, self._db, self._lock = path, connection, lock

    @staticmethod
    def create(directory: Path, meta: dict[str, Any]) -> Store:
        """Make `directory` and a new results file in it; `meta` is stored as JSON values.

        Raises:
            InputError: the directory holds results already, or cannot be made.
        """
        path = directory / FILE
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError("command line", "--out", str(directory), f"a folder to write to ({error})") from None
        lock = _lock(directory)
        try:
            if path.exists():
                raise InputError(
                    "command line", "--out", str(directory), "a folder without results, or --resume to continue them"
                )
            store = Store(path, _connect(path, "rwc"), lock)
            with store._errors():
                store._db.execute("PRAGMA journal_mode = WAL")
                store._db.execute("PRAGMA synchronous = NORMAL")
                script = f"BEGIN; {_TABLES} PRAGMA application_id = {APPLICATION_ID};"
                store._db.executescript(f"{script} PRAGMA user_version = {SCHEMA_VERSION}; COMMIT;")
            store.set_meta({"schema_version": SCHEMA_VERSION, **meta})
        except BaseException:
            os.close(lock)
            raise
        return store

    @staticmethod
    def resume(directory: Path) -> Store:
        """Open the results in `directory` to continue them; an older schema is brought up to date first."""
        path = _existing(directory)
        lock = _lock(directory)
        try:
            store = Store(path, _connect(path, "rw"), lock)
            store._check()
            store._migrate()
        except BaseException:
            os.close(lock)
            raise
        return store

    @staticmethod
    def read(directory: Path) -> Store:
        """Open the results in `directory` for reading; a campaign may be writing at the same time.

        The folder need not be writable.
        """
        path = _existing(directory)
        store = Store(path, _connect_to_read(path))
        store._check()
        return store

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file and give up the lock."""
        self._db.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def set_meta(self, values: dict[str, Any]) -> None:
        """Store or replace values, as JSON."""
        rows = [(key, json.dumps(value, sort_keys=True)) for key, value in values.items()]
        with self._errors(), self._db:
            self._db.executemany("INSERT OR REPLACE INTO meta VALUES (?, ?)", rows)

    def meta(self) -> dict[str, Any]:
        """All values of the table `meta`."""
        with self._errors():
            return {key: json.loads(value) for key, value in self._db.execute("SELECT key, value FROM meta")}

    def add_attempt(self, record: AttemptRecord) -> None:
        """Commit an attempt and its pictures."""
        row = [getattr(record, name) for name in _ATTEMPT_COLUMNS]
        for name in _JSON_COLUMNS:
            value = getattr(record, name)
            row[_ATTEMPT_COLUMNS.index(name)] = (
                None if value is None and name != "tree" else json.dumps(value, default=_plain)
            )
        marks = ", ".join("?" * len(row))
        pictures = [(record.seed, record.attempt, name, png) for name, png in record.pictures.items()]
        with self._errors(), self._db:
            self._db.execute(f"INSERT INTO attempts ({', '.join(_ATTEMPT_COLUMNS)}) VALUES ({marks})", row)
            self._db.executemany("INSERT INTO pictures VALUES (?, ?, ?, ?)", pictures)

    def add_episode(self, record: EpisodeRecord) -> None:
        """Commit the end of an episode."""
        row = [getattr(record, name) for name in _EPISODE_COLUMNS]
        with self._errors(), self._db:
            self._db.execute(f"INSERT INTO episodes ({', '.join(_EPISODE_COLUMNS)}) VALUES (?, ?, ?, ?, ?, ?)", row)

    def forget_unfinished(self, seed: int | None = None) -> None:
        """Delete attempts of episodes that did not end: of one seed, or of all."""
        where = "seed NOT IN (SELECT seed FROM episodes) AND (?1 IS NULL OR seed = ?1)"
        with self._errors(), self._db:
            for table in ("attempts", "pictures"):
                self._db.execute(f"DELETE FROM {table} WHERE {where}", (seed,))

    def attempts(self, seed: int | None = None, large: bool = True) -> list[AttemptRecord]:
        """Attempts in order of seed and attempt, without their pictures: of one episode, or all.

        Args:
            large: with tree and waypoints, which are most of the file; None in the records without.
        """
        return list(self.each_attempt(seed, () if large else LARGE_COLUMNS))

    def each_attempt(
        self, seed: int | None = None, without: Collection[str] = (), tree: Callable[[Any], Any] = lambda tree: tree
    ) -> Iterator[AttemptRecord]:
        """The same one after the other, for files whose trees do not fit into memory together.

        Args:
            without: of `tree` and `waypoints`, what is not read.
            tree: what is kept of each tree.
        """
        with self._errors():
            there = self._columns()  # version 1 knew neither placement error nor waypoints
            columns = [name for name in _ATTEMPT_COLUMNS if name in there and name not in without]
            which, values = ("", ()) if seed is None else (" WHERE seed = ?", (seed,))
            query = f"SELECT {', '.join(columns)} FROM attempts{which} ORDER BY seed, attempt"
            rows = self._db.execute(query, values)
            for row in rows:
                yield _attempt(dict(zip(columns, row, strict=True)), tree)

    def episodes(self) -> list[EpisodeRecord]:
        """All episodes that ended, in order of seed."""
        query = f"SELECT {', '.join(_EPISODE_COLUMNS)} FROM episodes ORDER BY seed"
        with self._errors():
            return [EpisodeRecord(*row) for row in self._db.execute(query)]

    def pictures(self, seed: int, attempt: int) -> dict[str, bytes]:
        """Pictures of an attempt, name -> PNG, in the order in which they were made."""
        query = "SELECT name, png FROM pictures WHERE seed = ? AND attempt = ? ORDER BY rowid"
        with self._errors():
            return dict(self._db.execute(query, (seed, attempt)).fetchall())

    def _columns(self) -> set[str]:
        return {row[1] for row in self._db.execute("PRAGMA table_info(attempts)")}

    def _migrate(self) -> None:
        """Add what an older version did not know, all or nothing."""
        with self._errors(), self._db:
            if self._db.execute("PRAGMA user_version").fetchone()[0] == SCHEMA_VERSION:
                return
            self._db.execute("BEGIN IMMEDIATE")
            for name in sorted(_ADDED_COLUMNS.keys() - self._columns()):
                self._db.execute(f"ALTER TABLE attempts ADD COLUMN {name} {_ADDED_COLUMNS[name]}")
            self._db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
        self.set_meta({"schema_version": SCHEMA_VERSION})

    def _check(self) -> None:
        try:
            with self._errors():
                application = self._db.execute("PRAGMA application_id").fetchone()[0]
                schema = self._db.execute("PRAGMA user_version").fetchone()[0]
            if application != APPLICATION_ID:
                raise InputError(self.path, "", "another program's database", "a file that `pickproof run` wrote")
            if schema > SCHEMA_VERSION:
                raise InputError(
                    self.path, "schema_version", schema, f"at most {SCHEMA_VERSION}; a newer pickproof wrote this file"
                )
        except BaseException:
            self._db.close()
            raise

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise _explain(self.path, error) from None


def record_hash(attempts: Sequence[AttemptRecord], episodes: Sequence[EpisodeRecord]) -> str:
    """SHA-256 over attempts, outcomes and poses in order of seed and attempt.

    Floats enter by their exact bits (`float.hex`; poses after the attempt as little-endian IEEE 754); times, pictures
    and everything about the machine stay out.
    """
    digest = hashlib.sha256()
    for a in sorted(attempts, key=lambda a: (a.seed, a.attempt)):
        chosen = (a.estimate_T_world_part, a.estimate_score, a.error_mm, a.error_deg, a.grasp)
        outcome = (a.moved, a.success, str(a.reason), a.parts_in_bin_before, a.n_estimates, len(a.part_poses_after))
        digest.update(json.dumps(_exact(["attempt", a.seed, a.attempt, outcome, chosen])).encode() + b"\n")
        digest.update(np.array(a.part_poses_after, dtype="<f8").tobytes())
    for e in sorted(episodes, key=lambda e: e.seed):
        line = ["episode", e.seed, e.parts_dropped, e.parts_picked, e.end, e.attempts]
        digest.update(json.dumps(_exact(line)).encode() + b"\n")
    return digest.hexdigest()


def _exact(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_exact(v) for v in value]
    return value.hex() if isinstance(value, float) else value


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)


def _attempt(row: dict[str, Any], tree: Callable[[Any], Any]) -> AttemptRecord:
    for name in _JSON_COLUMNS:
        if row.get(name) is not None:
            row[name] = _decoded(row[name])
    if "tree" in row:
        row["tree"] = tree(row["tree"])
    row["moved"], row["success"] = bool(row["moved"]), bool(row["success"])
    return AttemptRecord(**row)


def _decoded(text: str) -> Any:
    try:
        return msgspec.json.decode(text)  # three times as quick, which 500 MB of trees show
    except msgspec.DecodeError:
        return json.loads(text)  # knows NaN and Infinity, which json.dumps writes


def _existing(directory: Path) -> Path:
    path = directory / FILE
    if not path.is_file():
        raise InputError(path, "", "missing file", "a folder that `pickproof run --out` wrote")
    return path


def _connect(path: Path, mode: str) -> sqlite3.Connection:
    try:
        return sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", uri=True, timeout=_PATIENCE_S)
    except sqlite3.Error as error:
        raise _explain(path, error) from None


def _connect_to_read(path: Path) -> sqlite3.Connection:
    """A connection that reads, also where SQLite may not make the files beside the database that its WAL mode needs.

    There the file is read as one that never changes, unless a journal beside it holds what it lacks.

    Raises:
        InputError: the file may not be read.
        StoreError: there is such a journal.
    """
    if not os.access(path, os.R_OK):
        raise InputError(path, "", "no permission to read it", "a file that you may read")
    connection = _connect(path, "ro")
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
    return _connect(path, "ro&immutable=1")


def _lock(directory: Path) -> int:
    """One writer: an advisory lock on the folder, given up by the system when the process ends."""
    handle = os.open(directory, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        raise StoreError(f"{directory}: locked; another `pickproof run` is writing there") from None
    return handle


def _explain(path: Path, error: sqlite3.Error) -> PickproofError:
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    if code in (sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_CORRUPT):
        return InputError(path, "", str(error), "a file that `pickproof run` wrote")
    if code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
        return StoreError(f"{path}: {error}; attempts up to here are kept, make room and continue with --resume")
    if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return StoreError(f"{path}: {error}; another program holds it, continue with --resume when it has let go")
    return StoreError(f"{path}: {error}")
