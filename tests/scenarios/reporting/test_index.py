import json
import re
import subprocess
from pathlib import Path

import pytest

from pickproof.cell.errors import InputError
from pickproof.scenarios.commands.cli import main
from pickproof.scenarios.config.provenance import git_commit
from pickproof.scenarios.config.scenario import load_scenario
from pickproof.scenarios.reporting.figures import library
from pickproof.scenarios.reporting.index import find_runs, read_run
from tests.scenarios.planted_episode import write_campaign


def test_runs_are_in_order_of_time_with_their_commits(tmp_path):
    for name, chance, started in (("b", 0.9, "2026-02-01T00:00:00"), ("a", 0.5, "2026-03-01T00:00:00")):
        scenario = load_scenario("bracket", [f"carry.speed_scale={chance}", "count=5"])
        write_campaign(tmp_path / name, scenario, range(3), started=started, commit=f"{name}" * 40)
    out = tmp_path / "index.html"
    assert main(["index", str(tmp_path), "--out", str(out)]) == 0
    page = out.read_text().replace(library(), "")
    assert page.index("b" * 10 + "</code>") < page.index("a" * 10 + "</code>")
    assert page.count("Plotly.newPlot(") == 1
    runs = [read_run(folder, out) for folder in find_runs([tmp_path, tmp_path / "a"])]
    assert [r.folder.name for r in runs] == ["a", "b"]
    for r in runs:
        assert f"{100 * r.summary['success_rate']:.1f} %" in page
    assert not re.search(r"(src|href)=\"http", page)


def test_each_scenario_has_its_own_line_and_first_attempts_none(tmp_path: Path) -> None:
    changes = {"a": [], "b": [], "c": ["count=6"], "d": ["stop.attempt_limit=1"]}
    for day, (name, change) in enumerate(changes.items(), start=1):
        write_campaign(tmp_path / name, load_scenario("bracket", change), range(2), started=f"2026-02-0{day}T00:00:00")
    out = tmp_path / "index.html"
    assert main(["index", str(tmp_path), "--out", str(out)]) == 0
    page = out.read_text(encoding="utf-8").replace(library(), "")
    figure = json.loads(re.search(r"const f = (.*?); Plotly", page).group(1))
    assert [trace["x"] for trace in figure["data"]] == [[0, 1], [2]]
    assert page.count("first attempts</span>") == 1


def test_a_folder_without_runs_is_refused(tmp_path):
    with pytest.raises(InputError, match="DIR"):
        find_runs([tmp_path])


def test_the_commit_is_that_of_the_checkout_and_marks_changes(tmp_path):
    def git(*words):
        who = ["-c", "user.name=a", "-c", "user.email=a@b"]
        return subprocess.run(["git", "-C", tmp_path, *who, *words], check=True, capture_output=True, text=True).stdout

    git("init", "-q")
    (tmp_path / "other.txt").write_text("1")
    git("add", ".")
    git("commit", "-qm", "none of ours")
    assert git_commit(tmp_path) == ""
    (tmp_path / "a.py").write_text("1")
    git("add", ".")
    git("commit", "-qm", "one")
    head = git("rev-parse", "HEAD").strip()
    assert git_commit(tmp_path) == head
    (tmp_path / "a.py").write_text("2")
    assert git_commit(tmp_path) == head + "+"
    assert git_commit(tmp_path.parent) == ""
