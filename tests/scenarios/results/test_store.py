import dataclasses
import sqlite3

import numpy as np
import pytest

from pickproof.cell.errors import InputError
from pickproof.scenarios.files.atomic import StoreError
from pickproof.scenarios.results.records import EpisodeRecord
from pickproof.scenarios.results.store import FILE, SCHEMA_VERSION, Store, record_hash
from tests.scenarios.fake_episode import fake_attempt

META = {"seed": 0, "oracle": []}


def attempts(seed=0, n=6):
    rng = np.random.default_rng(seed)
    return [fake_attempt(seed, i, 30 - i, 4, rng, pictures=True) for i in range(n)]


def test_records_come_back_bit_for_bit(tmp_path):
    records, end = attempts(), EpisodeRecord(0, 30, 5, "stopped", 6, 1.5)
    with Store.create(tmp_path / "new" / "run", META) as store:
        for a in records:
            store.add_attempt(a)
        store.add_episode(end)
    with Store.read(tmp_path / "new" / "run") as store:
        assert store.attempts() == [dataclasses.replace(a, pictures={}) for a in records]
        assert store.episodes() == [end]
        assert store.pictures(0, next(a.attempt for a in records if a.moved)) == {"depth": b"\x89PNG not really"}
        assert store.meta() == META | {"schema_version": SCHEMA_VERSION}
        assert record_hash(store.attempts(), store.episodes()) == record_hash(records, [end])


def test_attempts_are_committed_as_they_end(tmp_path):
    with Store.create(tmp_path, META) as store:
        for i, a in enumerate(attempts()):
            store.add_attempt(a)
            with Store.read(tmp_path) as reader:
                assert len(reader.attempts()) == i + 1


def test_hash_leaves_out_times_and_order_but_nothing_else():
    records, end = attempts(), EpisodeRecord(0, 30, 5, "stopped", 6, 1.5)
    base = record_hash(records, [end])
    assert record_hash(records[::-1], [dataclasses.replace(end, wall_s=9.0)]) == base
    slower = [dataclasses.replace(a, perceive_s=9.0, robot_s=1.0, wall_s=7.0, pictures={}) for a in records]
    assert record_hash(slower, [end]) == base
    pose = np.array(records[0].part_poses_after)
    pose[0, 0] = np.nextafter(pose[0, 0], 1)  # the last bit counts
    for change in ({"part_poses_after": pose}, {"n_estimates": 99}, {"grasp": "other"}, {"estimate_score": 0.123}):
        assert record_hash([dataclasses.replace(records[0], **change), *records[1:]], [end]) != base
    assert record_hash(records, [dataclasses.replace(end, end="stuck")]) != base


def test_unfinished_episodes_are_forgotten(tmp_path):
    with Store.create(tmp_path, META) as store:
        for a in attempts(0) + attempts(1):
            store.add_attempt(a)
        store.add_episode(EpisodeRecord(0, 30, 5, "stopped", 6, 1.5))
        store.forget_unfinished()
        assert {a.seed for a in store.attempts()} == {0}
        assert store.pictures(1, 0) == {}


def test_newer_schema_is_refused(tmp_path):
    Store.create(tmp_path, META).close()
    with sqlite3.connect(tmp_path / FILE) as db:
        db.execute(f"PRAGMA user_version = {SCHEMA_VERSION + 1}")
    db.close()
    for opening in (Store.read, Store.resume):
        with pytest.raises(InputError, match=rf"schema_version: {SCHEMA_VERSION + 1} .* newer pickproof"):
            opening(tmp_path)


def test_what_is_no_results_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="missing file"):
        Store.read(tmp_path / "nothing")
    (tmp_path / FILE).write_text("this is text, and long enough to be taken for the header of a database file " * 20)
    with pytest.raises(InputError, match="not a database"):
        Store.read(tmp_path)
    (tmp_path / FILE).unlink()
    with sqlite3.connect(tmp_path / FILE) as db:
        db.execute("CREATE TABLE songs (title TEXT)")
    db.close()
    with pytest.raises(InputError, match="another program's database"):
        Store.read(tmp_path)


def test_results_are_never_overwritten(tmp_path):
    Store.create(tmp_path, META).close()
    with pytest.raises(InputError, match="--resume"):
        Store.create(tmp_path, META)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="--out"):
        Store.create(tmp_path / "file" / "run", META)


def test_one_writer(tmp_path):
    with Store.create(tmp_path, META):
        with pytest.raises(StoreError, match="locked"):
            Store.resume(tmp_path)
        Store.read(tmp_path).close()
    Store.resume(tmp_path).close()


def test_another_program_holds_the_file(tmp_path):
    with Store.create(tmp_path, META) as store:
        store._db.execute("PRAGMA busy_timeout = 10")
        other = sqlite3.connect(tmp_path / FILE, isolation_level=None)
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(StoreError, match="database is locked"):
            store.add_attempt(attempts()[0])
        other.close()
        store.add_attempt(attempts()[0])


def test_disk_full_keeps_what_was_committed(tmp_path):
    records = attempts(n=40)
    with Store.create(tmp_path, META) as store:
        store._db.execute("PRAGMA max_page_count = 12")  # SQLite's own limit raises the error of a full disk
        with pytest.raises(StoreError, match=r"full.*--resume"):
            for a in records:
                store.add_attempt(a)
    with Store.read(tmp_path) as store:
        kept = store.attempts()
    assert 0 < len(kept) < 40
    assert kept == [dataclasses.replace(a, pictures={}) for a in records[: len(kept)]]


def test_results_of_the_first_version_are_still_read(tmp_path):
    """They knew no placement error."""
    with Store.create(tmp_path, META) as store:
        store.add_attempt(fake_attempt(0, 0, 5, 5, np.random.default_rng(0), False))
        written = store.attempts()
    with sqlite3.connect(tmp_path / FILE) as db:
        for name in ("place_mm", "place_deg", "waypoints"):
            db.execute(f"ALTER TABLE attempts DROP COLUMN {name}")
        db.execute("PRAGMA user_version = 1")
    db.close()
    with Store.read(tmp_path) as store:
        assert store.attempts() == written
    with Store.resume(tmp_path) as store:  # brought up to date, so that it can be written to
        second = fake_attempt(0, 1, 4, 4, np.random.default_rng(1), False)
        store.add_attempt(second)
        assert store.attempts() == [*written, second]
        assert store.meta()["schema_version"] == SCHEMA_VERSION
    with Store.resume(tmp_path) as store:
        assert store.attempts() == [*written, second]


def test_one_episode_and_what_is_small_of_it(tmp_path):
    records = attempts(0) + attempts(1)
    with Store.create(tmp_path, META) as store:
        for a in records:
            store.add_attempt(a)
        assert store.attempts(1) == [dataclasses.replace(a, pictures={}) for a in records[6:]]
        small = store.attempts(large=False)
        assert {a.tree for a in small} == {None}
        assert record_hash(small, []) == record_hash(store.attempts(), [])
