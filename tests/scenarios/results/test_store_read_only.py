"""Results in a folder where the reader may not write: on a read-only mount, or of another user."""

from __future__ import annotations

import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from pickproof.cell.errors import InputError
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.files.atomic import StoreError
from pickproof.scenarios.results import connection as module
from pickproof.scenarios.results.records import AttemptRecord
from pickproof.scenarios.results.store import FILE, Store
from tests.scenarios.planted_episode import write_campaign

pytestmark = pytest.mark.slow

NOBODY = 65534
ATTEMPTS = 12


@pytest.fixture
def campaign() -> Iterator[Path]:
    """A finished campaign in a folder that every user may enter; only the database is there."""
    root = Path(tempfile.mkdtemp(prefix="pickproof-test-"))
    folder = root / "run"
    scenario = load_scenario("bracket", ["count=4", "stop.attempt_limit=4"])
    write_campaign(folder, scenario, range(3), versions={"pickproof": "0"})
    root.chmod(0o755)
    assert [p.name for p in folder.iterdir()] == [FILE]
    yield folder
    folder.chmod(0o755)
    shutil.rmtree(root)


def read_only(folder: Path) -> None:
    for path in folder.iterdir():
        path.chmod(0o444)
    folder.chmod(0o555)


def as_another_user(words: list[str], cwd: Path) -> subprocess.CompletedProcess[str]:
    """The command line after giving up root, where the test runs as root; all is imported before."""
    code = (
        "import os, sys, pyarrow.parquet, plotly.graph_objects\n"
        "import pickproof.scenarios.commands.cli as cli\n"
        "import pickproof.scenarios.commands.pick.explain, pickproof.scenarios.commands.pick.report\n"
        "import pickproof.scenarios.commands.decide.compare, pickproof.scenarios.commands.pick.index\n"
        "import pickproof.scenarios.commands.pick.export, pickproof.scenarios.commands.decide.baseline\n"
        "import pickproof.scenarios.reporting.explain, pickproof.scenarios.reporting.report\n"
        "import pickproof.scenarios.comparison.compare, pickproof.scenarios.reporting.index\n"
        "import pickproof.scenarios.reporting.parquet, pickproof.scenarios.comparison.baseline\n"
        "import encodings.unicode_escape  # jinja2 asks for it; that user may not reach the library\n"
        f"if os.geteuid() == 0: os.setgroups([]); os.setgid({NOBODY}); os.setuid({NOBODY})\n"
        "sys.exit(cli.main(sys.argv[1:]))\n"
    )
    return subprocess.run(
        [sys.executable, "-c", code, *words],
        cwd=cwd, capture_output=True, text=True, timeout=300, env=os.environ | {"HOME": str(cwd)},
    )  # fmt: skip


@pytest.fixture
def elsewhere(campaign: Path) -> Path:
    """Where that user may write."""
    folder = campaign.parent / "elsewhere"
    folder.mkdir(mode=0o777)
    folder.chmod(0o777)
    return folder


@pytest.mark.parametrize(
    "words",
    [
        ["report", "{run}", "--out", "r.html"],
        ["explain", "{run}", "--attempt", "0"],
        ["compare", "{run}", "{run}"],
        ["index", "{run}", "--out", "i.html"],
        ["export", "{run}", "--parquet", "a.parquet"],
        ["baseline", "{run}", "--baseline", "b.json"],
    ],
    ids=lambda words: words[0],
)
def test_every_command_reads_another_users_results(words: list[str], campaign: Path, elsewhere: Path) -> None:
    read_only(campaign)
    done = as_another_user([word.format(run=campaign) for word in words], elsewhere)
    assert (done.returncode, done.stderr) == (0, "")
    assert [p.name for p in campaign.iterdir()] == [FILE]


def test_what_cannot_be_written_is_said_in_one_line(campaign: Path, elsewhere: Path) -> None:
    read_only(campaign)
    done = as_another_user(["report", str(campaign)], elsewhere)
    assert done.returncode == 2 and "cannot be written" in done.stderr and done.stderr.count("\n") == 1


def test_a_file_that_may_not_be_read_is_said_in_one_line(campaign: Path, elsewhere: Path) -> None:
    (campaign / FILE).chmod(0o000)
    done = as_another_user(["explain", str(campaign), "--attempt", "0"], elsewhere)
    assert done.returncode == 2 and "permission" in done.stderr and done.stderr.count("\n") == 1


def leave_journal(folder: Path) -> None:
    """One more attempt, only in the write-ahead log, as after a kill of the writer."""
    copies = folder.with_name("copies")
    with Store.resume(folder) as store:
        store.add_attempt(AttemptRecord(9, 0, True, True, "", 4, 1))
        shutil.copytree(folder, copies)
    for name in (f"{FILE}-wal", f"{FILE}-shm"):
        shutil.copy(copies / name, folder / name)
    shutil.copy(copies / FILE, folder / FILE)
    shutil.rmtree(copies)
    assert (folder / f"{FILE}-wal").stat().st_size > 0


def test_attempts_in_the_journal_are_never_left_out_unsaid(campaign: Path, elsewhere: Path) -> None:
    leave_journal(campaign)
    (campaign / f"{FILE}-shm").unlink()
    read_only(campaign)
    done = as_another_user(["explain", str(campaign), "--attempt", str(ATTEMPTS)], elsewhere)
    assert done.returncode == 2 and f"{FILE}-wal" in done.stderr and done.stderr.count("\n") == 1


def test_attempts_in_the_journal_are_read_where_its_index_is_there(campaign: Path, elsewhere: Path) -> None:
    """As while another user's campaign runs."""
    leave_journal(campaign)
    read_only(campaign)
    done = as_another_user(["explain", str(campaign), "--attempt", str(ATTEMPTS)], elsewhere)
    assert done.returncode == 0 and "seed 9" in done.stdout


class _Refused(sqlite3.OperationalError):
    sqlite_errorcode = sqlite3.SQLITE_CANTOPEN


@pytest.fixture
def refusing(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """SQLite that cannot make its files beside a database, and a system that says the folder is not writable."""
    modes: list[str] = []
    real, access = module.connect, os.access

    def connect(path: Path, mode: str) -> sqlite3.Connection:
        modes.append(mode)
        if mode == "ro":
            return sqlite3.connect(":memory:", factory=_Refusing)
        return real(path, mode)

    monkeypatch.setattr(module, "connect", connect)
    monkeypatch.setattr(module.os, "access", lambda p, how: how == os.R_OK and access(p, how))
    return modes


class _Refusing(sqlite3.Connection):
    def execute(self, *_: object) -> sqlite3.Cursor:  # type: ignore[override]
        raise _Refused("unable to open database file")


def test_a_file_that_cannot_change_is_read_as_such(campaign: Path, refusing: list[str]) -> None:
    with Store.read(campaign) as store:
        assert len(store.attempts()) == ATTEMPTS
    assert refusing == ["ro", "ro&immutable=1"]


def test_a_writable_folder_is_never_taken_for_one_that_cannot_change(
    campaign: Path, refusing: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module.os, "access", lambda p, how: True)
    with pytest.raises(StoreError, match="unable to open"):
        Store.read(campaign)
    assert refusing == ["ro"]


def test_journals_without_content_hold_nothing(campaign: Path, refusing: list[str]) -> None:
    (campaign / f"{FILE}-wal").touch()
    (campaign / f"{FILE}-journal").touch()
    with Store.read(campaign) as store:
        assert len(store.attempts()) == ATTEMPTS
    (campaign / f"{FILE}-journal").write_bytes(b"\xd9")
    with pytest.raises(StoreError, match=r"-journal: holds data that results.sqlite lacks"):
        Store.read(campaign)


def test_a_file_without_permission(campaign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module.os, "access", lambda p, how: False)
    with pytest.raises(InputError, match="no permission"):
        Store.read(campaign)
