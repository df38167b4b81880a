import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pickproof.cell.errors import PickproofError
from pickproof.scenarios.commands.cli import main
from pickproof.scenarios.commands.registry import GROUPS
from pickproof.scenarios.files.atomic import free_folder
from pickproof.scenarios.results.store import FILE, Store

pytestmark = pytest.mark.slow

FAKE = [sys.executable, str(Path(__file__).parents[1] / "fake_cli.py")]
SMALL = ["--set", "count=6", "--set", "stop.attempt_limit=20"]
KEYS = {
    "scenario", "scenario_hash", "weights_hash", "inputs_hash", "seed", "episodes", "oracle", "attempts", "successes",
    "success_rate", "wilson95", "cluster95", "clearance", "no_picks", "reasons", "ends", "cycle_s", "picks_per_hour",
    "wall_s", "wall_per_attempt_s", "record_hash", "parts_left_per_episode",
}  # fmt: skip


def fake(*words, cwd):
    return subprocess.run([*FAKE, *words], cwd=cwd, capture_output=True, text=True, timeout=120)


def one_line(capsys):
    err = capsys.readouterr().err
    assert err.startswith("pickproof: error: ") and err.count("\n") == 1
    return err


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["run", "bracket", "--episodes", "0"], ["--episodes", "'0'", "from 1"]),
        (["run", "bracket", "--seed", "-1"], ["--seed", "'-1'", "from 0"]),
        (["run", "bracket", "--workers", "0"], ["--workers", "from 1"]),
        (["run", "bracket", "--workers", "two"], ["--workers", "'two'", "integer"]),
        (["run", "bracket", "--oracle", "luck"], ["--oracle", "luck", "perception"]),
        (["fly"], ["fly", "run", "report"]),
        ([], ["COMMAND"]),
    ],
)
def test_bad_arguments_are_one_line_and_exit_2(words, names, capsys):
    assert main(words) == 2
    err = one_line(capsys)
    for name in names:
        assert name in err


def test_bad_results_are_one_line_and_exit_2(tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == 2
    assert "missing file" in one_line(capsys)
    Store.create(tmp_path, {}).close()
    with sqlite3.connect(tmp_path / FILE) as db:
        db.execute("PRAGMA user_version = 99")
    db.close()
    assert main(["report", str(tmp_path)]) == 2
    assert "schema_version: 99" in one_line(capsys)


def test_list_and_help(capsys):
    assert main(["list"]) == 0
    assert capsys.readouterr().out.count("bracket") >= 2
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    places = [text.index(f"─ {group} ─") for group in GROUPS]
    assert places == sorted(places)
    assert main(["--version"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("pickproof ") and out.count("\n") == 1 and err == ""


@pytest.mark.parametrize("words", [[], ["run"], ["tune"], ["train"], ["onboard"], ["benchmark", "perception"]])
def test_help_waits_for_no_heavy_import(words):
    code = "import sys; from pickproof.scenarios.commands.cli import main; main(sys.argv[1:]); print(*sys.modules)"
    command = [sys.executable, "-c", code, *words, "--help"]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert not {"torch", "open3d", "pybullet", "numpy", "pydantic"} & set(loaded)


def test_run_leaves_summary_and_report(tmp_path):
    done = fake("run", "bracket", *SMALL, "--episodes", "2", "--workers", "2", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "pick success" in done.stdout and "record hash" in done.stdout
    out = tmp_path / "out" / "bracket-0"
    summary = json.loads((out / "summary.json").read_text())
    assert set(summary) == KEYS
    failures = summary["attempts"] - summary["successes"] + summary["no_picks"]
    assert sum(summary["reasons"].values()) == failures
    assert sum(summary["ends"].values()) == summary["episodes"] == 2
    assert free_folder(out) == tmp_path / "out" / "bracket-0-2"
    assert main(["report", str(out)]) == 0
    with Store.read(out) as store:
        assert store.meta()["command"].startswith("pickproof run bracket --set count=6")


def test_existing_results_and_bad_fields_exit_2(faked, tmp_path, capsys):
    Store.create(tmp_path / "a", {}).close()
    assert faked("run", "bracket", "--out", "a") == 2
    assert "--resume" in one_line(capsys)
    assert faked("run", "bracket", "--set", "gripper=bad_input", "--out", "b") == 2
    assert "weights.safetensors" in one_line(capsys)


def attempts_in(out):
    try:
        with Store.read(out) as store:
            return store.attempts()
    except PickproofError:  # not there yet
        return []


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_interrupt_keeps_finished_attempts_and_resume_completes(tmp_path, how):
    words = ["run", "bracket", *SMALL, "--set", "gripper=slow", "--episodes", "3"]
    out = tmp_path / "stopped"
    process = subprocess.Popen(
        [*FAKE, *words, "--workers", "2", "--out", str(out)], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 300  # a busy machine, and numba compiling
    while len(attempts_in(out)) < 4 and time.monotonic() < deadline:
        time.sleep(0.05)
    if how == signal.SIGINT:
        os.killpg(process.pid, how)  # as the terminal does: driver and workers
    else:
        process.send_signal(how)
    err = process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert "Traceback" not in err and err.count("\n") == 1
    kept = attempts_in(out)
    assert f"interrupted; {len(kept)} attempts are kept" in err
    for seed in {a.seed for a in kept}:  # none is missing in between
        mine = [a.attempt for a in kept if a.seed == seed]
        assert mine == list(range(len(mine)))
    assert len(kept) >= 4
    assert main(["report", str(out)]) == 0
    if how == signal.SIGTERM:
        return
    resumed = fake(*words, "--workers", "2", "--resume", "--json", "--out", str(out), cwd=tmp_path)
    straight = fake(*words, "--json", "--out", "straight", cwd=tmp_path)
    assert json.loads(resumed.stdout)["record_hash"] == json.loads(straight.stdout)["record_hash"]


@pytest.mark.parametrize("field", ["gripper=nonesuch", "gripper=missing.yaml"])
def test_a_run_that_cannot_start_leaves_no_results(
    field: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "bracket", "--set", field, "--out", str(tmp_path / "run")]) == 2
    error = capsys.readouterr().err
    assert field.partition("=")[2] in error and len(error.splitlines()) == 1
    assert not (tmp_path / "run").exists()
