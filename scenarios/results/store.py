"""The results file: DIR/results.sqlite, one writer, every attempt committed as it ends."""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pickproof.cell.errors import InputError
from pickproof.scenarios.results.columns import columns_of, values_of
from pickproof.scenarios.results.connection import connect, connect_to_read, explained, lock
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord

FILE = "results.sqlite"
SCHEMA_VERSION = 2
APPLICATION_ID = 0x7069636B  # "pick", in the file's header

_ATTEMPT, _EPISODE = columns_of(AttemptRecord), columns_of(EpisodeRecord)
LARGE_COLUMNS = tuple(c.name for c in _ATTEMPT if c.large)
_TABLES = f"""
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE episodes ({", ".join(c.sql for c in _EPISODE)}, PRIMARY KEY (seed));
CREATE TABLE attempts ({", ".join(c.sql for c in _ATTEMPT)}, PRIMARY KEY (seed, attempt));
CREATE TABLE pictures (
    seed INTEGER NOT NULL, attempt INTEGER NOT NULL, name TEXT NOT NULL, png BLOB NOT NULL,
    PRIMARY KEY (seed, attempt, name));
"""


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
        held = lock(directory)
        try:
            if path.exists():
                raise InputError(
                    "command line", "--out", str(directory), "a folder without results, or --resume to continue them"
                )
            store = Store(path, connect(path, "rwc"), held)
            with store._errors():
                store._db.execute("PRAGMA journal_mode = WAL")
                store._db.execute("PRAGMA synchronous = NORMAL")
                script = f"BEGIN; {_TABLES} PRAGMA application_id = {APPLICATION_ID};"
                store._db.executescript(f"{script} PRAGMA user_version = {SCHEMA_VERSION}; COMMIT;")
            store.set_meta({"schema_version": SCHEMA_VERSION, **meta})
        except BaseException:
            os.close(held)
            raise
        return store

    @staticmethod
    def resume(directory: Path) -> Store:
        """Open the results in `directory` to continue them; an older schema is brought up to date first."""
        path = _existing(directory)
        held = lock(directory)
        try:
            store = Store(path, connect(path, "rw"), held)
            store._check()
            store._migrate()
        except BaseException:
            os.close(held)
            raise
        return store

    @staticmethod
    def read(directory: Path) -> Store:
        """Open the results in `directory` for reading; a campaign may be writing at the same time.

        The folder need not be writable.
        """
        path = _existing(directory)
        store = Store(path, connect_to_read(path))
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
        pictures = [(record.seed, record.attempt, name, png) for name, png in record.pictures.items()]
        with self._errors(), self._db:
            self._insert("attempts", record)
            self._db.executemany("INSERT INTO pictures VALUES (?, ?, ?, ?)", pictures)

    def add_episode(self, record: EpisodeRecord) -> None:
        """Commit the end of an episode."""
        with self._errors(), self._db:
            self._insert("episodes", record)

    def _insert(self, table: str, record: AttemptRecord | EpisodeRecord) -> None:
        columns = columns_of(type(record))
        names, marks = ", ".join(c.name for c in columns), ", ".join("?" * len(columns))
        row = [c.to_sql(getattr(record, c.name)) for c in columns]
        self._db.execute(f"INSERT INTO {table} ({names}) VALUES ({marks})", row)

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
        where, values = ("", ()) if seed is None else (" WHERE seed = ?", (seed,))
        yield from self._read_attempts(f"{where} ORDER BY seed, attempt", values, without, tree)

    def nth_attempt(self, n: str | int) -> AttemptRecord:
        """The attempt of index `n` in order of seed and attempt, in which the report lists them; no other is read.

        Raises:
            InputError: there is none.
        """
        with self._errors():
            count = self._db.execute("SELECT COUNT(*) FROM attempts").fetchone()[0]
        try:
            index = int(n)
        except ValueError:
            index = -1
        if not 0 <= index < count:
            valid = f"an integer from 0 to {count - 1}" if count else "nothing, there is no attempt"
            raise InputError("command line", "--attempt", n, valid)
        key = "SELECT seed, attempt FROM attempts ORDER BY seed, attempt LIMIT 1 OFFSET ?"
        return next(self._read_attempts(f" WHERE (seed, attempt) = ({key})", (index,)))

    def _read_attempts(
        self,
        which: str,
        values: tuple[int, ...],
        without: Collection[str] = (),
        tree: Callable[[Any], Any] = lambda tree: tree,
    ) -> Iterator[AttemptRecord]:
        """Records of the rows that `which` selects, one after the other."""
        with self._errors():
            there = self._columns("attempts")
            names = [c.name for c in _ATTEMPT if c.name in there and c.name not in without]
            for row in self._db.execute(f"SELECT {', '.join(names)} FROM attempts{which}", values):
                found = values_of(AttemptRecord, dict(zip(names, row, strict=True)))
                if "tree" in found:
                    found["tree"] = tree(found["tree"])
                yield AttemptRecord(**found)

    def episodes(self) -> list[EpisodeRecord]:
        """All episodes that ended, in order of seed."""
        with self._errors():
            names = [c.name for c in _EPISODE if c.name in self._columns("episodes")]
            rows = self._db.execute(f"SELECT {', '.join(names)} FROM episodes ORDER BY seed")
            return [EpisodeRecord(**values_of(EpisodeRecord, dict(zip(names, row, strict=True)))) for row in rows]

    def pictures(self, seed: int, attempt: int) -> dict[str, bytes]:
        """Pictures of an attempt, name -> PNG, in the order in which they were made."""
        query = "SELECT name, png FROM pictures WHERE seed = ? AND attempt = ? ORDER BY rowid"
        with self._errors():
            return dict(self._db.execute(query, (seed, attempt)).fetchall())

    def _columns(self, table: str) -> set[str]:
        """Names of the columns that are there; an older file has fewer."""
        return {row[1] for row in self._db.execute(f"PRAGMA table_info({table})")}

    def _migrate(self) -> None:
        """Add the columns that an older version did not know, all or nothing."""
        with self._errors(), self._db:
            self._db.execute("BEGIN IMMEDIATE")
            for table, columns in (("attempts", _ATTEMPT), ("episodes", _EPISODE)):
                there = self._columns(table)
                for column in columns:
                    if column.name not in there:
                        self._db.execute(f"ALTER TABLE {table} ADD COLUMN {column.added_sql}")
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
            raise explained(self.path, error) from None


def _existing(directory: Path) -> Path:
    path = directory / FILE
    if not path.is_file():
        raise InputError(path, "", "missing file", "a folder that `pickproof run --out` wrote")
    return path
