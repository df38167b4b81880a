"""What the exit code says without a reader, with a full or missing output, and after an unforeseen exception."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from pickproof.scenarios.commands import cli
from pickproof.scenarios.commands.more import list_
from pickproof.scenarios.comparison.baseline import baseline_of, write_baseline
from pickproof.scenarios.config.scenario import load_scenario
from tests.scenarios.planted_episode import write_campaign

pytestmark = pytest.mark.slow

HERE = Path(__file__).parents[1]
FAKE = [sys.executable, str(HERE / "fake_cli.py")]
PLANTED = [sys.executable, str(HERE / "planted_cli.py")]
SMALL = ["--set", "count=6", "--set", "stop.attempt_limit=20"]


def unread(words: list[str], cwd: Path, both: bool = False) -> tuple[int, str]:
    """Exit code and stderr of a process whose stdout, and with `both` its stderr too, is a pipe without a reader."""
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(
            words, cwd=cwd, stdout=writing, stderr=writing if both else subprocess.PIPE, text=True, timeout=300
        )
    finally:
        os.close(writing)
    return done.returncode, done.stderr or ""


@pytest.mark.parametrize(("json_too", "both"), [([], True), (["--json"], False)])
def test_a_campaign_goes_on_without_a_reader(json_too: list[str], both: bool, tmp_path: Path) -> None:
    words = [*FAKE, "run", "bracket", *SMALL, "--episodes", "2", "--out", "run", *json_too]
    code, err = unread(words, tmp_path, both)
    assert code == 0 and "Traceback" not in err and "BrokenPipe" not in err
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["episodes"] == 2


@pytest.fixture(scope="module")
def baseline(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("baseline")
    scenario = load_scenario("bracket", ["count=10", "carry.speed_scale=0.95"])
    write_campaign(folder / "a", scenario, range(200))
    return write_baseline(folder / "b.json", baseline_of(folder / "a"))


@pytest.mark.parametrize(("rate", "limit", "code"), [(0.95, 200, 0), (0.6, 200, 1), (0.95, 5, 3)])
def test_a_gates_verdict_survives_a_closed_pipe(
    rate: float, limit: int, code: int, baseline: Path, tmp_path: Path
) -> None:
    words = [*PLANTED, "gate", "bracket", "--set", "count=10", "--set", f"carry.speed_scale={rate}", "--out", "gate"]
    words += ["--baseline", str(baseline), "--max-episodes", str(limit), "--json", "g.json", "--junit", "g.xml"]
    assert unread(words, tmp_path)[0] == code
    assert json.loads((tmp_path / "g.json").read_text())["exit_code"] == code
    assert "testsuite" in (tmp_path / "g.xml").read_text()


@pytest.mark.parametrize("words", [["list"], ["--help"], ["run", "--help"], ["grasps", "export", "bracket"]])
def test_short_commands_do_not_mind_a_closed_pipe(words: list[str], tmp_path: Path) -> None:
    assert unread([*FAKE, *words], tmp_path) == (0, "")


def test_an_output_that_is_full_is_an_error_and_no_verdict(tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([*FAKE, "list"], cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "No space left" in done.stderr


def test_a_missing_output_stops_nothing(baseline: Path, tmp_path: Path) -> None:
    words = [*PLANTED, "gate", "bracket", "--set", "count=10", "--set", "carry.speed_scale=0.6", "--out", "gate"]
    command = " ".join(f"'{word}'" for word in [*words, "--baseline", str(baseline), "--json", "g.json"])
    done = subprocess.run(["sh", "-c", f"{command} <&- >&- 2>&-"], cwd=tmp_path)
    assert done.returncode == 1 and (tmp_path / "g.json").is_file()


def test_a_name_that_is_no_text_is_printed(tmp_path: Path) -> None:
    name = os.fsdecode(b"b\xe4r.json")
    done = subprocess.run(
        [*FAKE, "grasps", "export", "bracket", "--out", name], cwd=tmp_path, capture_output=True, timeout=120
    )
    assert done.returncode == 0 and b"wrote" in done.stdout and (tmp_path / name).is_file()


def test_an_unforeseen_exception_is_one_line_and_never_exit_code_1(tmp_path: Path, monkeypatch, capsys) -> None:
    def surprise() -> int:
        raise ValueError("no such\nthing")

    monkeypatch.setattr(list_, "list_", surprise)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert cli.main(["list"]) == cli.INTERNAL == 70
    err = capsys.readouterr().err
    (file,) = tmp_path.iterdir()
    assert err == f"pickproof: internal error: ValueError: no such thing; the traceback is in {file}\n"
    assert "in surprise" in file.read_text()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "none"))
    assert cli.main(["list"]) == 70  # where nothing can be written either


@pytest.mark.parametrize(
    ("raised", "code"), [(SystemExit("words"), 70), (SystemExit(None), 0), (KeyboardInterrupt(), 130), (OSError(), 2)]
)
def test_other_ends(raised: BaseException, code: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def ending() -> int:
        raise raised

    monkeypatch.setattr(list_, "list_", ending)
    assert cli.main(["list"]) == code
    assert type(sys.stdout).__name__ != "_Lasting"  # as it was before


BROKEN = ["--set", "count=6", "--set", "gripper=broken"]


@pytest.mark.parametrize(
    "words",
    [
        ["run", "bracket", "--episodes", "2"],
        ["run", "bracket", "--episodes", "1", "--json"],
        ["baseline", "bracket", "--episodes", "2", "--whole"],
        ["sweep", "bracket", "--set", "carry.speed_scale=0.5,0.6", "--episodes", "1"],
        ["attribute", "bracket", "--episodes", "2"],
    ],
    ids=lambda words: words[0],
)
def test_where_nothing_was_measured_it_is_said(
    words: list[str], faked: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`dies_at_once` never makes an attempt: all that is recorded is the physics that broke down."""
    how = ["--set", "count=6", "--set", "gripper=dies_at_once", "--out", "out"]
    assert faked(*words, *how) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert "nothing was measured" in last and "simulation_error" in last and "at infinity" in last
    assert not list(tmp_path.glob("*.baseline.json"))


def test_a_gate_over_broken_physics_has_no_verdict(
    planted: Callable[..., int], baseline: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["gate", "bracket", "--set", "count=10", "--set", "gripper=broken", "--out", "gate"]
    words += ["--baseline", str(baseline), "--json", "g.json"]
    assert planted(*words) == 2
    assert "nothing was measured" in capsys.readouterr().err
    assert not (tmp_path / "g.json").exists()


def test_some_that_broke_down_are_counted_as_failures(faked: Callable[..., int], tmp_path: Path) -> None:
    assert faked("run", "bracket", *BROKEN, "--episodes", "1", "--out", "run") == 0
    reasons = json.loads((tmp_path / "run" / "summary.json").read_text())["reasons"]
    assert reasons["simulation_error"] == 1
