import dataclasses
import sqlite3
from dataclasses import replace

import numpy as np
import pytest

from pickproof.cell.errors import InputError
from pickproof.scenarios.files.atomic import StoreError
from pickproof.scenarios.results.record_hash import record_hash
from pickproof.scenarios.results.records import AttemptRecord, EpisodeRecord
from pickproof.scenarios.results.store import APPLICATION_ID, FILE, SCHEMA_VERSION, Store
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
        assert store.attempts() == [replace(a, pictures={}) for a in records]
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
    assert record_hash(records[::-1], [replace(end, wall_s=9.0)]) == base
    slower = [replace(a, perceive_s=9.0, robot_s=1.0, wall_s=7.0, pictures={}) for a in records]
    assert record_hash(slower, [end]) == base
    pose = np.array(records[0].part_poses_after)
    pose[0, 0] = np.nextafter(pose[0, 0], 1)  # the last bit counts
    for change in ({"part_poses_after": pose}, {"n_estimates": 99}, {"grasp": "other"}, {"estimate_score": 0.123}):
        assert record_hash([replace(records[0], **change), *records[1:]], [end]) != base
    assert record_hash(records, [replace(end, end="stuck")]) != base


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
    assert kept == [replace(a, pictures={}) for a in records[: len(kept)]]


EPISODES = """seed INTEGER PRIMARY KEY, parts_dropped INTEGER NOT NULL, parts_picked INTEGER NOT NULL,
    end TEXT NOT NULL, attempts INTEGER NOT NULL, wall_s REAL NOT NULL"""
FIRST = """seed INTEGER NOT NULL, attempt INTEGER NOT NULL, moved INTEGER NOT NULL, success INTEGER NOT NULL,
    reason TEXT NOT NULL, parts_in_bin_before INTEGER NOT NULL, n_estimates INTEGER NOT NULL,
    estimate_T_world_part TEXT, estimate_score REAL, error_mm REAL, error_deg REAL, grasp TEXT NOT NULL,
    sensing_s REAL NOT NULL, perceive_s REAL NOT NULL, choose_s REAL NOT NULL, plan_s REAL NOT NULL,
    robot_s REAL NOT NULL, part_poses_after TEXT NOT NULL, tree TEXT NOT NULL, wall_s REAL NOT NULL"""
OLD_SCHEMAS = {1: FIRST, 2: f"{FIRST}, place_mm REAL, place_deg REAL, waypoints TEXT"}
"""The tables as the versions up to 2 wrote them: literal text, which no change of a record changes."""


@pytest.fixture(params=OLD_SCHEMAS)
def old_file(tmp_path, request):
    """The folder of a file that an older version wrote, with two attempts, one of them a no-pick."""
    with sqlite3.connect(tmp_path / FILE) as db:
        db.executescript(
            f"""CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
            CREATE TABLE episodes ({EPISODES});
            CREATE TABLE attempts ({OLD_SCHEMAS[request.param]}, PRIMARY KEY (seed, attempt));
            CREATE TABLE pictures (seed INTEGER NOT NULL, attempt INTEGER NOT NULL, name TEXT NOT NULL,
                png BLOB NOT NULL, PRIMARY KEY (seed, attempt, name));
            PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {request.param};
            INSERT INTO episodes VALUES (0, 5, 1, 'stuck', 2, 3.5)"""
        )
        rows = [
            "0, 0, 1, 1, '', 5, 3, '[[1.0, 0.0, 0.0, 0.5], [0.0, 1.0, 0.0, 0.25]]', 0.75, 0.5, 1.5, 'side', 0.4, 0.3, "
            "0.02, 0.1, 2.0, '[[0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0]]', '[{\"score\": NaN}]', 4.0",
            "0, 1, 0, 0, 'no_detection', 4, 0, NULL, NULL, NULL, NULL, '', 0.4, 0.3, 0.0, 0.0, 0.0, '[]', 'null', 1.0",
        ]
        more = ["", ""] if request.param == 1 else [", 1.0, 2.0, '[{\"q\": [0.5]}]'", ", NULL, NULL, NULL"]
        for row, rest in zip(rows, more, strict=True):
            db.execute(f"INSERT INTO attempts VALUES ({row}{rest})")
    db.close()
    return tmp_path


def test_files_of_older_versions_are_read_and_continued(old_file):
    with Store.read(old_file) as store:
        first, second = written = store.attempts()
        (end,) = store.episodes()
    assert (end.end, end.wall_s, end.parts_dropped) == ("stuck", 3.5, 5)
    assert first.estimate_T_world_part == ((1.0, 0.0, 0.0, 0.5), (0.0, 1.0, 0.0, 0.25))
    assert first.part_poses_after == ((0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0),)
    assert (first.success, first.grasp, first.error_deg, first.wall_s) == (True, "side", 1.5, 4.0)
    assert np.isnan(first.tree[0]["score"])
    assert (second.moved, second.reason, second.tree, second.waypoints) == (False, "no_detection", None, None)
    assert second.estimate_T_world_part is None and second.part_poses_after == ()
    third = fake_attempt(1, 0, 4, 4, np.random.default_rng(1), False)
    with Store.resume(old_file) as store:  # brought up to date, so that it can be written to
        store.add_attempt(third)
        store.add_attempt(replace(second, attempt=2))
        assert store.attempts()[1:] == [second, replace(second, attempt=2), third]
        assert store.meta()["schema_version"] == SCHEMA_VERSION
    with Store.resume(old_file) as store:
        assert [a.grasp for a in store.attempts()] == [*(a.grasp for a in written), "", third.grasp]


def test_a_field_that_a_file_does_not_know_is_added(tmp_path):
    """Whatever is added to a record with a default can be read from, and written to, files without it."""
    records = attempts()
    with Store.create(tmp_path, META) as store:
        for a in records[:3]:
            store.add_attempt(a)
    added = [f for f in dataclasses.fields(AttemptRecord) if f.default is not dataclasses.MISSING]
    with sqlite3.connect(tmp_path / FILE) as db:
        for f in added:
            db.execute(f"ALTER TABLE attempts DROP COLUMN {f.name}")
    db.close()
    with Store.resume(tmp_path) as store:
        assert all(getattr(a, f.name) == f.default for a in store.attempts() for f in added)
        store.add_attempt(records[3])
        assert store.attempts()[3] == replace(records[3], pictures={})


def test_one_attempt_is_read_alone(tmp_path):
    records = attempts(0, 20) + attempts(1, 20)
    with Store.create(tmp_path, META) as store:
        for a in records:
            store.add_attempt(a)
    with sqlite3.connect(tmp_path / FILE) as db:  # whoever decodes another row fails
        db.execute("UPDATE attempts SET tree = 'no JSON' WHERE NOT (seed = 1 AND attempt = 7)")
    db.close()
    with Store.read(tmp_path) as store:
        statements: list[str] = []
        store._db.set_trace_callback(statements.append)
        found = store.nth_attempt("27")
        store._db.set_trace_callback(None)
        assert found == replace(records[27], pictures={})
        reading = [s for s in statements if "tree" in s]
        assert [len(store._db.execute(s).fetchall()) for s in reading] == [1]
        plan = " ".join(row[3] for row in store._db.execute(f"EXPLAIN QUERY PLAN {reading[0]}"))
        assert "SEARCH attempts USING INDEX" in plan and "USING COVERING INDEX" in plan
        with pytest.raises(ValueError):
            store.nth_attempt(26)
        for bad in ("-1", "40", "first", "1.5"):
            with pytest.raises(InputError, match="from 0 to 39"):
                store.nth_attempt(bad)


def test_one_episode_and_what_is_small_of_it(tmp_path):
    records = attempts(0) + attempts(1)
    with Store.create(tmp_path, META) as store:
        for a in records:
            store.add_attempt(a)
        assert store.attempts(1) == [replace(a, pictures={}) for a in records[6:]]
        small = store.attempts(large=False)
        assert {a.tree for a in small} == {None}
        assert record_hash(small, []) == record_hash(store.attempts(), [])
